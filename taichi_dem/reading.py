"""Why a file cannot be read, in words."""

from __future__ import annotations


def unreadable(error: Exception) -> str:
    """What is wrong with a file that raised ``error`` when it was read."""
    if isinstance(error, FileNotFoundError):
        return "there is no such file"
    if isinstance(error, IsADirectoryError):
        return "is a folder; must be a file"
    if isinstance(error, PermissionError):
        return "cannot be read: no permission"
    if isinstance(error, UnicodeDecodeError):
        return f"must be text in UTF-8; byte {error.start} is not"
    reason = error.strerror if isinstance(error, OSError) else None
    return f"cannot be read: {reason or error}"
