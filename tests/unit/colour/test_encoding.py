"""CIELAB in 16 bits."""

from __future__ import annotations

import numpy as np

from tilefab.colour.encoding import decode_lab16, encode_lab16


def test_reference_values_of_the_icc_encoding():
    lab = np.array([[[0.0, -128.0, 127.0], [100.0, 0.0, 0.0], [50.0, 1.0, -1.0]]])
    assert encode_lab16(lab).tolist() == [[[0, 0, 65535], [65535, 32896, 32896], [32768, 33153, 32639]]]


def test_out_of_range_is_clipped():
    lab = np.array([[[-5.0, -200.0, 300.0], [400.0, 127.9, -128.1]]])
    assert encode_lab16(lab).tolist() == [[[0, 0, 65535], [65535, 65535, 0]]]


def test_every_code_of_every_channel_comes_back():
    codes = np.repeat(np.arange(65536, dtype=np.uint16)[:, None, None], 3, axis=2)
    assert (encode_lab16(decode_lab16(codes)) == codes).all()


def test_strips_make_no_difference():
    lab = np.random.default_rng(1).uniform(-100, 100, (1300, 3, 3)).astype(np.float32)
    assert (encode_lab16(lab) == np.concatenate([encode_lab16(lab[:700]), encode_lab16(lab[700:])])).all()
    codes = encode_lab16(lab)
    assert (decode_lab16(codes) == np.concatenate([decode_lab16(codes[:513]), decode_lab16(codes[513:])])).all()
