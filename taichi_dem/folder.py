"""A run's folder: whether one may be written, what belongs to it, and its pictures."""

from __future__ import annotations

import json
import os
import tempfile
import zipfile
from contextlib import suppress
from pathlib import Path

from taichi_dem.frames import INDEX, read_index
from taichi_dem.output import HISTORY, SCENE, SUMMARY
from taichi_dem.snapshot import FILE as STATE
from taichi_dem.validation import InputError, Problem
from taichi_dem.wording import quantity

ATTEMPTS = 5  # of runs that begin together, and take away folders that others have just seen
LAST_GOOD = "last_good.npz"
PICTURES = ("overview.png", "bed.png", "depression.png", "energy.png", "piston.png")
FILES = (SUMMARY, SCENE, "scene.spheres.npz", HISTORY, STATE, LAST_GOOD, INDEX, *PICTURES)


def holds_run(folder: Path) -> bool:
    """Whether ``folder`` is one that a run has left."""
    return (folder / SUMMARY).is_file() and (folder / SCENE).is_file()


def check_free(folder: Path, overwrite: bool) -> None:
    """Raise ``InputError`` unless a run may write into ``folder``: it is new, or empty, or holds
    a run that is to be overwritten."""
    if folder.exists() and folder.is_dir() and any(folder.iterdir()):
        if not holds_run(folder):
            raise _refused(folder, "holds other files; must be new, empty, or the folder of a run")
        if not overwrite:
            other = "choose another folder, or replace it with --overwrite"
            raise _refused(folder, f"holds {_describe(folder)}; {other}")
    if problem := unwritable(folder):
        raise InputError([problem])


def unwritable(folder: Path) -> Problem | None:
    """Why nothing can be written into ``folder``, or ``None``. It is made and removed again, or a
    file in it: permissions do not tell for everybody and everywhere."""
    if folder.is_symlink() and not folder.exists():
        return _problem(folder, f"is a link to {os.readlink(folder)}, which is not there")
    if folder.exists() and not folder.is_dir():
        return _problem(folder, "is a file; must be a folder")
    there = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    if not there.is_dir():
        return _problem(folder, f"cannot be made: {there} is a file, not a folder")
    for attempt in range(ATTEMPTS):
        try:
            _try(folder)
            break
        except OSError as error:
            if attempt + 1 == ATTEMPTS or not isinstance(error, FileNotFoundError):
                return _problem(
                    folder, f"cannot be written: {there} takes nothing ({error.strerror})"
                )
    return None


def _try(folder: Path) -> None:
    """Make the folder and write into it; then both are as they were."""
    made: list[Path] = []
    try:
        for path in reversed((folder, *folder.absolute().parents)):
            if not path.exists():
                path.mkdir(exist_ok=True)
                made.append(path)
        with tempfile.TemporaryFile(dir=folder):
            pass
    finally:
        with suppress(OSError):  # somebody else has put something there
            for path in reversed(made):
                path.rmdir()


def clear(folder: Path) -> None:
    """Remove what a run has left in ``folder``, and nothing else."""
    frames = [file for files in read_index(folder).values() for file in files]
    for name in (*FILES, *frames):
        (folder / name).unlink(missing_ok=True)


def draw(folder: Path) -> list[Path]:
    """Draw the pictures of the run in ``folder``; returns their paths. Raises ``InputError`` if it
    holds no run that can be read."""
    if not folder.is_dir():
        raise InputError([Problem("folder", str(folder), "is not a folder")])
    try:
        from taichi_dem import plot

        return plot.draw(folder)
    except ModuleNotFoundError as error:
        raise ImportError(
            f"pictures need the {error.name} library: pip install 'taichi-dem[view]'"
        ) from None
    except FileNotFoundError:
        rule = f"must be the folder of a run, with {STATE} or {HISTORY}"
        raise InputError([Problem("folder", str(folder), rule)]) from None
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError([Problem("folder", str(folder), f"cannot be read: {error}")]) from None


def _describe(folder: Path) -> str:
    try:
        summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        reached = quantity(float(summary["simulated_time_s"]), "s")
        outcome = str(summary["outcome"]).partition(":")[0]
    except (OSError, ValueError, KeyError, TypeError):
        return "a run"
    return f"a run of {reached} ({outcome})"


def _problem(folder: Path, rule: str) -> Problem:
    return Problem("output", str(folder), rule)


def _refused(folder: Path, rule: str) -> InputError:
    return InputError([_problem(folder, rule)])
