"""A shorter way through Taichi's front end, which turns the same functions into the same kernels.

A function is read from its file and laid out for an error message again wherever a kernel calls it,
and once for each of its expressions: half of the time that it takes to start with all kernels kept
on disk.  Here a function is read once, an expression's place is told by its line alone, and the
product of two vectors is written down at once, where Taichi reads three functions for it.
"""

import functools
import importlib
import operator
from collections.abc import Callable
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
    products: Any = importlib.import_module("taichi.lang.matrix_ops")
    if hasattr(products, "dot"):
        products.dot = _dot(products.dot)


def _place(context: Any, node: Any) -> str:
    line = node.lineno + context.lineno_offset
    text = context.src[node.lineno - 1]
    return f'File "{context.file}", line {line}, in {context.func.func.__name__}:\n{text}\n'


def _dot(whole: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """A shorter ``whole``, for two vectors of a kernel."""
    impl: Any = importlib.import_module("taichi.lang.impl")
    expression: Any = importlib.import_module("taichi.lang.expr").Expr

    @functools.wraps(whole)
    def dot(a: Any, b: Any) -> Any:
        vectors = isinstance(a, expression) and isinstance(b, expression)
        if not vectors or len(a.get_shape()) != 1 or a.get_shape() != b.get_shape():
            return whole(a, b)
        builder = impl.get_runtime().current_kernel.ast_builder()
        products = impl.expr_init(a * b)
        terms = [impl.subscript(builder, products, k) for k in range(a.get_shape()[0])]
        return impl.expr_init(functools.reduce(operator.add, terms))

    return dot
