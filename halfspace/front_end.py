"""A shorter way through Taichi's front end, which turns the same functions into the same kernels.

A function is read from its file and laid out for an error message again wherever a kernel calls it,
and once for each of its expressions: half of the time that it takes to start with all kernels kept
on disk.  Here a function is read once, and an expression's place is told by its line alone.
"""

import functools
import importlib
from typing import Any


def shorten(name: str) -> None:
    """Change the modules of the compiler ``name`` where they are as they were in Taichi 1.7."""
    if name != "taichi":  # its fork remembers by itself
        return
    functions: Any = importlib.import_module("taichi.lang.kernel_impl")
    for reader in ("getsourcelines", "getsourcefile"):
        if hasattr(functions, reader):
            setattr(functions, reader, functools.cache(getattr(functions, reader)))
    transformer: Any = importlib.import_module("taichi.lang.ast.ast_transformer_utils")
    context: Any = getattr(transformer, "ASTTransformerContext", None)
    if hasattr(context, "get_pos_info"):
        context.get_pos_info = _place


def _place(context: Any, node: Any) -> str:
    line = node.lineno + context.lineno_offset
    text = context.src[node.lineno - 1]
    return f'File "{context.file}", line {line}, in {context.func.func.__name__}:\n{text}\n'
