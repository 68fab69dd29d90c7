"""What ``summary.json`` says of a simulation, beside its state."""

from __future__ import annotations

from typing import Any

from halfspace import backend
from taichi_dem.memory import by_effect


def of(sim: Any) -> dict[str, Any]:
    """The outcome of a :class:`taichi_dem.Simulation`, how it was run, what steps, lists and output
    took, and each effect with its memory and, where it has been measured, its share of a step."""
    engine = sim._engine
    held = by_effect(engine)
    shares = {cost.name: cost.summary() for cost in sim._memo.get("effect_costs", ())}
    return {
        "outcome": sim._outcome,
        "driver": engine.pace.driver,
        "threads": backend.THREADS,
        "precision": backend.PRECISION,
        "rebuilds": engine.rebuilds,
        "skin_m": engine.skin.width,
        **engine.ground.margins(),
        **({"asleep": int(sim.asleep.sum())} if sim.effects.sleep else {}),
        "seconds": {
            "steps": sim._stepping - engine.listing,
            "contact lists": engine.listing,
            "output": sim._writing,
        },
        "effects": {
            effect.name: {
                "on": effect.on,
                "reason": effect.reason,
                "memory_bytes": held.get(effect.name, 0),
                **(shares.get(effect.name, {"share_of_step": None}) if effect.on else {}),
            }
            for effect in sim.effects.listed
        },
    }
