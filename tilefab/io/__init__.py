"""Files: scans and their metadata, faces, profiles, measurements, texture maps and the record of a run."""

from tilefab.io.atomic import atomic_path, atomic_write_bytes
from tilefab.io.faces import PrintTags, pixel_hash, read_print_pixels, write_preview, write_print_tiff
from tilefab.io.manifest import FaceRecord, Manifest, locked_folder
from tilefab.io.scans import Scan, read_mask, read_scan
from tilefab.io.texture_map_file import load_texture_map, save_texture_map

__all__ = [
    "FaceRecord",
    "Manifest",
    "PrintTags",
    "Scan",
    "atomic_path",
    "atomic_write_bytes",
    "load_texture_map",
    "locked_folder",
    "pixel_hash",
    "read_mask",
    "read_print_pixels",
    "read_scan",
    "save_texture_map",
    "write_preview",
    "write_print_tiff",
]
