"""The kernels kept on disk stay usable after a process was killed."""

import os
import time

from halfspace.backend import ABANDONED, unlock_cache


def test_an_abandoned_lock_is_removed_and_one_in_use_is_not(tmp_path):
    abandoned, in_use, kernel = (tmp_path / name for name in ("a.lock", "b.lock", "a.tic"))
    for path in (abandoned, in_use, kernel):
        path.touch()
    long_ago = time.time() - 2 * ABANDONED
    for path in (abandoned, kernel):
        os.utime(path, (long_ago, long_ago))
    unlock_cache(tmp_path)
    assert not abandoned.exists()
    assert in_use.exists()
    assert kernel.exists()
    unlock_cache(tmp_path / "absent")
