"""Profiles judged by tools that nobody here wrote: Little CMS, and ArgyllCMS's icclu.

Little CMS comes with imagecodecs; device links, which imagecodecs can't apply alone, go through the system's own
liblcms2. What has more than four inks goes through icclu, which reads profiles of version 2.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import shutil
import subprocess
from functools import cache
from pathlib import Path
from typing import Any, Literal

import imagecodecs
import numpy as np
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]
Tool = Literal["lcms2", "icclu"]

INTENTS = {"perceptual": 0, "relative": 1, "saturation": 2, "absolute": 3}
LCMS_SPACES = {b"CMY ": "cmy", b"CMYK": "cmyk"}
NOT_RESAMPLED = 0x0100  # cmsFLAGS_NOOPTIMIZE: the file's own tables, not a smaller grid made of them
_LINES = 200_000
_LINK_FORMATS = {"u2": (6 << 16) | (4 << 3) | 2, "f4": (1 << 22) | (6 << 16) | (4 << 3) | 4}  # CMYK, lcms2.h


def icclu_missing() -> str | None:
    """Why icclu can't be asked, or None."""
    return None if shutil.which("icclu") else "icclu (ArgyllCMS) is not installed"


def tools_for(profile: Path) -> list[Tool]:
    """The tools that can look colours up in a profile, the preferred one first."""
    head = profile.read_bytes()[:20]
    tools: list[Tool] = ["lcms2"] if head[16:20] in LCMS_SPACES else []
    if head[8] < 4 and icclu_missing() is None:
        tools.append("icclu")
    return tools


def lab_of(
    profile: Path, ink_frac: NDArray[np.floating], *, tool: Tool | None = None, intent: str = "absolute"
) -> Float64Array:
    """Lab (M, 3) that a profile's A2B table gives for inks (M, N), 0 to 1."""
    if (tool or _first_tool(profile)) == "icclu":
        return _icclu(profile, "f", intent, ink_frac)
    percent = (100.0 * np.asarray(ink_frac)).astype(np.float32)
    return _lcms(profile, percent, to_inks=False, intent=intent, dtype="f4").astype(np.float64)


def inks_of(
    profile: Path, lab_d50: NDArray[np.floating], *, tool: Tool | None = None, intent: str = "absolute"
) -> Float64Array:
    """Ink fractions (M, N) that a profile's B2A table gives for Lab (M, 3)."""
    if (tool or _first_tool(profile)) == "icclu":
        return np.clip(_icclu(profile, "b", intent, lab_d50), 0.0, 1.0)
    inks = _lcms(profile, np.asarray(lab_d50).astype(np.float32), to_inks=True, intent=intent, dtype="f4")
    return np.clip(inks.astype(np.float64) / 100.0, 0.0, 1.0)


def printed_counts(profile: Path, colours: NDArray[Any], dtype: str, intent: str) -> NDArray[Any]:
    """Inks (M, N) in counts, as a program has them printed: Lab as float32, or sRGB (M, 3) as uint8 or uint16."""
    if colours.dtype.kind == "f":
        return _lcms(profile, colours.astype(np.float32), to_inks=True, intent=intent, dtype=dtype)
    data = profile.read_bytes()
    space = LCMS_SPACES[data[16:20]]
    srgb = imagecodecs.cms_profile("srgb")
    found = imagecodecs.cms_transform(
        np.ascontiguousarray(colours[np.newaxis]),
        srgb,
        data,
        colorspace="rgb",
        outcolorspace=space,
        outdtype=dtype,
        intent=INTENTS[intent],
    )
    return np.asarray(found)[0]


def largest_total_percent(profile: Path, dtype: str, seed: int = 0) -> float:
    """Largest total ink among many colours, printable or not, in integers of a type, over three intents."""
    random = np.random.default_rng(seed)
    lab = random.uniform([0, -128, -128], [100, 127, 127], (100_000, 3)).astype(np.float32)
    dark = random.normal([10, 0, 0], [10, 10, 10], (100_000, 3)).astype(np.float32)
    srgb = random.integers(0, 256, (100_000, 3), dtype=np.uint8)
    most = 0
    for intent in ("perceptual", "relative", "saturation"):
        for colours in (lab, dark, srgb, srgb // 5):
            most = max(most, int(printed_counts(profile, colours, dtype, intent).sum(axis=1, dtype=np.int64).max()))
    return 100.0 * most / np.iinfo(np.dtype(dtype)).max


def linked(link: Path, inks: NDArray[Any]) -> NDArray[Any]:
    """Inks (M, 4) through a device link for CMYK, by Little CMS: uint16, or float32 in percent."""
    library = link_library()
    if library is None:
        raise RuntimeError("liblcms2 is not installed")
    data = link.read_bytes()
    code = _LINK_FORMATS[inks.dtype.str[1:]]
    handle = library.cmsOpenProfileFromMem(data, len(data))
    transform = library.cmsCreateTransform(handle, code, None, code, 0, NOT_RESAMPLED) if handle else None
    if not transform:
        raise RuntimeError(f"{link}: Little CMS can't use the link")
    source = np.ascontiguousarray(inks)
    out = np.empty_like(source)
    library.cmsDoTransform(transform, source.ctypes.data, out.ctypes.data, len(source))
    library.cmsDeleteTransform(transform)
    library.cmsCloseProfile(handle)
    return out


@cache
def link_library() -> Any:
    """The system's Little CMS, or None."""
    path = ctypes.util.find_library("lcms2")
    if path is None:
        return None
    library = ctypes.CDLL(path)
    number, pointer = ctypes.c_uint32, ctypes.c_void_p
    library.cmsOpenProfileFromMem.argtypes = [ctypes.c_char_p, number]
    library.cmsOpenProfileFromMem.restype = pointer
    library.cmsCreateTransform.argtypes = [pointer, number, pointer, number, number, number]
    library.cmsCreateTransform.restype = pointer
    library.cmsDoTransform.argtypes = [pointer, pointer, pointer, number]
    library.cmsDoTransform.restype = None
    library.cmsDeleteTransform.argtypes = [pointer]
    library.cmsDeleteTransform.restype = None
    library.cmsCloseProfile.argtypes = [pointer]
    return library


def judges() -> str:
    """What judges, in a line."""
    parts = [imagecodecs.cms_version()]
    if icclu_missing() is None:
        said = subprocess.run(["icclu"], capture_output=True, text=True, check=False).stderr
        parts.append(f"icclu {said.split('V')[1].split()[0]}" if "V" in said else "icclu")
    return ", ".join(parts)


def _first_tool(profile: Path) -> Tool:
    tools = tools_for(profile)
    if not tools:
        raise RuntimeError(f"{profile}: no tool here looks colours up in it ({icclu_missing() or 'version 4'})")
    return tools[0]


def _lcms(profile: Path, colours: NDArray[np.float32], *, to_inks: bool, intent: str, dtype: str) -> NDArray[Any]:
    data, lab = profile.read_bytes(), imagecodecs.cms_profile("lab4")
    space = LCMS_SPACES[data[16:20]]
    source, target, names = (lab, data, ("lab", space)) if to_inks else (data, lab, (space, "lab"))
    found = imagecodecs.cms_transform(
        np.ascontiguousarray(colours[np.newaxis]),
        source,
        target,
        colorspace=names[0],
        outcolorspace=names[1],
        outdtype=dtype,
        intent=INTENTS[intent],
    )
    return np.asarray(found)[0]


def _icclu(profile: Path, function: str, intent: str, values: NDArray[np.floating]) -> Float64Array:
    command = ["icclu", "-v0", f"-f{function}", f"-i{intent[0]}", "-pl", str(profile)]
    parts = []
    for start in range(0, len(values), _LINES):
        rows = np.asarray(values[start : start + _LINES], dtype=np.float64)
        text = "\n".join(" ".join(f"{value:.7f}" for value in row) for row in rows)
        done = subprocess.run(command, input=text + "\n", capture_output=True, text=True, check=False)
        found = np.array(done.stdout.split(), dtype=np.float64)
        if done.returncode or not len(found) or len(found) % len(rows):
            raise RuntimeError(f"icclu can't use {profile}: {(done.stderr or done.stdout).strip()[:200]}")
        parts.append(found.reshape(len(rows), -1))
    return np.concatenate(parts)
