"""Hard cases, by kind; ``CASES`` are all of them."""

from tests.hard import (
    beds,
    edges,
    ground,
    impacts,
    laws,
    sleepers,
    sliding,
    sparse,
    squeezed,
    steps,
    surface,
)
from tests.hard.kit import CASES, Case, Figure, Setting

__all__ = [
    "CASES",
    "Case",
    "Figure",
    "Setting",
    "beds",
    "edges",
    "ground",
    "impacts",
    "laws",
    "sleepers",
    "sliding",
    "sparse",
    "squeezed",
    "steps",
    "surface",
]
