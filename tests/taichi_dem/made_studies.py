"""Studies made by hand, and what they say."""

import csv

from taichi_dem import study_report
from taichi_dem.settings import Settings
from taichi_dem.study_point import TABLE, Point
from taichi_dem.study_result import Reference, Study


def rows(folder):
    """Those of the table."""
    with (folder / TABLE).open() as file:
        return list(csv.DictReader(file))


def points():
    """Made by hand: (cost, error, uncertainty)."""
    numbers = [(1.0, 5e-2, 0.0), (2.0, 2e-3, 0.0), (3.0, 8e-4, 2e-4), (4.0, 9e-4, 0.0)]
    return [
        Point("step", Settings(1e-5), "finished", {}, {"mean": (e, u)}, None, e, u, times=[c])
        for c, e, u in numbers
    ]


def made_study(folder, found=(), last=32, **rest):
    """One of which the reference is there; over 1 s."""
    told = {k: rest.pop(k) for k in ("touched", "grounded") if k in rest}
    tight = rest.pop("tight", Settings(1e-6))
    reference = Reference(tight, last, last < 32, 5 if last < 32 else 1, **told)
    return Study(folder, rest.pop("window", 1.0), 32, reference, points=list(found), **rest)


def said_of(found):
    return list(study_report.sentences(found))
