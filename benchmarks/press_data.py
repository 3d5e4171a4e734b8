"""What profile benchmarks share: measurements, a press to judge with, profiles built by tilefab and by ArgyllCMS."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from tilefab.io.cgats import read_measurements
from tilefab.io.cgats_write import measurements_text

Float64Array = NDArray[np.float64]
TruePress = Callable[[Float64Array], Float64Array]

_CHUNK = 20_000
_DATE = "2026-11-24"
_CMYK = ("Cyan", "Magenta", "Yellow", "Black")


class NotBuiltError(Exception):
    """A profile or link was not made; the message says why."""


@dataclass(frozen=True)
class Patches:
    """Patches of a press, every recipe once."""

    ink_frac: Float64Array
    lab_d50: Float64Array
    ink_names: tuple[str, ...] = _CMYK

    def __len__(self) -> int:
        return len(self.ink_frac)

    def part(self, chosen: NDArray[np.integer] | NDArray[np.bool_]) -> Patches:
        """Some of them."""
        return Patches(self.ink_frac[chosen], self.lab_d50[chosen], self.ink_names)

    def noisy(self, deviation: float, random: np.random.Generator) -> Patches:
        """As a worse instrument reads them: Gaussian noise on L*, a* and b*."""
        read = self.lab_d50 + random.normal(0.0, deviation, self.lab_d50.shape)
        return Patches(self.ink_frac, read, self.ink_names)


def shared_folder(variable: str, name: str) -> Path | None:
    """A folder of data named by an environment variable, or beside the repository; None where there is none."""
    default = Path(__file__).resolve().parents[2] / "shared" / name
    folder = Path(os.environ.get(variable, default))
    return folder if folder.is_dir() else None


def load_patches(name: str) -> Patches | None:
    """Real characterisation data of a press, or None, having said so, where they are not here."""
    folder = shared_folder("TILEFAB_MEASUREMENTS", "measurements")
    path = None if folder is None else folder / f"{name}.ti3"
    if path is None or not path.is_file():
        print(f"SKIPPED: no {name}.ti3: let TILEFAB_MEASUREMENTS name the folder of the characterisation data")
        return None
    read = read_measurements(path)
    recipes, which = np.unique(read.ink_frac.round(6), axis=0, return_inverse=True)
    counts = np.bincount(which)
    lab = np.stack([np.bincount(which, read.lab_d50[:, axis]) / counts for axis in range(3)], axis=1)
    return Patches(recipes, lab, read.ink_names)


def true_press(patches: Patches, kernel: str = "cubic") -> TruePress:
    """A press that prints every patch exactly as measured: radial functions through all of them, and nothing else.

    It shares no code and no idea of ink with tilefab's press model or Argyll's.
    """
    fit = RBFInterpolator(patches.ink_frac, patches.lab_d50, kernel=kernel, degree=2 if kernel == "cubic" else 1)

    def lab(ink_frac: Float64Array) -> Float64Array:
        parts = [fit(ink_frac[start : start + _CHUNK]) for start in range(0, len(ink_frac), _CHUNK)]
        return np.concatenate(parts)

    return lab


def write_ti3(path: Path, patches: Patches, description: str) -> Path:
    """Patches as a measurement file."""
    text = measurements_text(
        patches.ink_frac, patches.lab_d50, ink_names=patches.ink_names, description=description, created=_DATE
    )
    path.write_text(text, encoding="utf-8")
    return path


@contextmanager
def workshop() -> Iterator[Path]:
    """A folder that goes away."""
    with tempfile.TemporaryDirectory(prefix="tilefab-bench-") as folder:
        yield Path(folder)


def run(command: Sequence[str | Path], cwd: Path | None = None) -> float:
    """Run a command to its end; the CPU seconds that it took, of all its threads.

    Raises
    ------
    NotBuiltError
        If it fails.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([str(word) for word in command], cwd=cwd, capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        said = (done.stderr or done.stdout).strip().splitlines() or ["no word"]
        raise NotBuiltError(f"{Path(command[0]).name} ended with {done.returncode}: {said[-1][:300]}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def tilefab(*words: str | Path) -> float:
    """Run a command of tilefab; its CPU seconds."""
    return run([Path(sys.executable).parent / "tilefab", *words])


def tilefab_profile(ti3: Path, out: Path, ink_limit_percent: float, *more: str) -> float:
    """Build a profile as a user does; the CPU seconds."""
    return tilefab("profile", "build", ti3, "-o", out, "--ink-limit", f"{ink_limit_percent:g}", *more)


def argyll_missing() -> str | None:
    """Why Argyll can't be asked for profiles, or None."""
    return None if shutil.which("colprof") and shutil.which("collink") else "ArgyllCMS is not installed"


def argyll_profile(ti3: Path, out: Path, *options: str) -> float:
    """Build a profile with colprof from the same file; the CPU seconds.

    Raises
    ------
    NotBuiltError
        If Argyll is not installed, or refuses.
    """
    missing = argyll_missing()
    if missing:
        raise NotBuiltError(missing)
    with workshop() as folder:
        shutil.copyfile(ti3, folder / "press.ti3")
        seconds = run(["colprof", *options, "press"], cwd=folder)
        shutil.copyfile(folder / "press.icc", out)
    return seconds
