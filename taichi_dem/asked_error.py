"""``taichi-dem run --error``: a scene with the settings that a pilot calls for, and what becomes of
effects that no setting turns on."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from taichi_dem.scene import Scene
from taichi_dem.scene_file import Run
from taichi_dem.validation import InputError, Problem

LEFT_OUT = ("warn", "refuse", "add")


def settled(
    scene: Scene, plan: Run, asked: float, left_out: str, say: Callable[[str], None]
) -> tuple[Scene, Run, dict[str, Any]]:
    """Scene and plan with the settings that the error ``asked`` calls for, and what
    ``summary.json`` says of them; ``say`` takes lines for people.

    ``left_out`` (one of ``LEFT_OUT``): effects of which more than ``asked`` is estimated, but which
    are laws and no settings, are warned of, refused (``InputError``), or added to the scene; those
    that cannot be estimated, or that the scene cannot have, are warned of in place of added.
    """
    from taichi_dem.choice import choose
    from taichi_dem.neglect import turned_on

    duration = _duration(plan)
    say(f"short runs, to choose settings for an error of {asked:g} …")
    choice = choose(scene, duration, asked, plan.estimate_neglected)
    if choice.missing and left_out == "refuse":
        rules = [f"cannot be met: {effect.sentence(asked)}" for effect in choice.missing]
        raise InputError([Problem("--error", asked, rule) for rule in rules])
    if left_out == "add":
        fuller = scene
        for effect in choice.missing:
            there = None if effect.size is None else turned_on(fuller, effect.name)
            if there is not None:
                say(f"turned on: {effect.sentence(asked).partition(':')[0]}")
                fuller = there
        if fuller is not scene:
            scene = fuller
            choice = choose(scene, duration, asked, plan.estimate_neglected)
    for line in choice.words():
        say(line)
    step = min(choice.settings.step, duration)
    plan = dataclasses.replace(plan, dt=step, duration=duration, steps=None)
    return choice.settings.applied(scene), plan, {"asked_error": choice.summary()}


def _duration(plan: Run) -> float:
    """What the run is to cover, s."""
    if plan.duration is not None:
        return plan.duration
    if plan.dt is None:
        rule = "must be given in s, or as run.steps with run.dt, where an error is asked for"
        raise InputError([Problem("run.duration", None, rule)])
    return (plan.steps or 1) * plan.dt
