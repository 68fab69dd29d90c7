"""Starts the kernel compiler, once and quietly; the only file that names it.

Environment variables, read when this module is first imported:

``HALFSPACE_BACKEND``    ``taichi`` (default) or ``quadrants``, its maintained fork
``HALFSPACE_PRECISION``  ``double`` (default) or ``single``
``HALFSPACE_THREADS``    threads of the parallel loops; default: one for each of :func:`cores`
"""

import importlib
import io
import os
import time
from contextlib import redirect_stdout, suppress
from pathlib import Path
from typing import Any

from halfspace.front_end import shorten


def _choice(variable: str, allowed: tuple[str, ...]) -> str:
    value = os.environ.get(variable, allowed[0])
    if value not in allowed:
        raise ValueError(f"{variable} = {value}: must be one of {', '.join(allowed)}")
    return value


def cores() -> int:
    """So many this process may use: ``taskset``, batch systems and containers give it a few."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _thread_count() -> int:
    value = os.environ.get("HALFSPACE_THREADS", str(cores()))
    if not value.isdigit() or int(value) < 1:
        raise ValueError(f"HALFSPACE_THREADS = {value}: must be a whole number >= 1")
    return int(value)


BACKEND = _choice("HALFSPACE_BACKEND", ("taichi", "quadrants"))
PRECISION = _choice("HALFSPACE_PRECISION", ("double", "single"))
THREADS = _thread_count()


for _name in ("TAICHI", "QUADRANTS"):
    os.environ.setdefault(f"ENABLE_{_name}_HEADER_PRINT", "0")
try:
    ti: Any = importlib.import_module(BACKEND)
except ModuleNotFoundError:
    raise ValueError(
        f"HALFSPACE_BACKEND = {BACKEND}: is not installed; pip install {BACKEND}"
    ) from None
shorten(BACKEND)

ABANDONED = 60  # s: a lock on the kernels kept on disk is held for as long as they are read
real = ti.f64 if PRECISION == "double" else ti.f32
_started = False


def start() -> None:
    """Start the compiler if it has not been started; contraction and fast maths stay off, so that
    the same code gives the same bits in every kernel.

    Its own pass over the flow of control takes most of the time of a long kernel's compilation and
    finds nothing that LLVM does not find: it stays off, too."""
    global _started
    if _started:
        return
    unlock_cache(Path(ti.lang.impl.default_cfg().offline_cache_file_path))
    with redirect_stdout(io.StringIO()):  # it would announce itself in the user's terminal
        ti.init(
            arch=ti.cpu,
            default_fp=real,
            default_ip=ti.i32,
            fast_math=False,
            cfg_optimization=False,
            cpu_max_num_threads=THREADS,
            log_level=ti.ERROR,
        )
    _started = True


def unlock_cache(cache: Path) -> None:
    """Remove the lock that a process left behind that was killed while it read or wrote the kernels
    in ``cache``: all later ones would compile everything anew, and say so in a log only."""
    for lock in cache.glob("*.lock"):
        with suppress(OSError):  # another process may be about the same
            if time.time() - lock.stat().st_mtime > ABANDONED:
                lock.unlink()
