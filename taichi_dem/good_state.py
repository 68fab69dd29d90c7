"""Where a run can go back to when a guard stops it."""

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from taichi_dem.engine import Engine

REMEMBERED = 200_000  # particles: what the contacts of more remember would take too much to keep


class GoodState:
    """The last state of an engine that was known to be sound.

    known   its time (s) and step, the spheres' position, velocity and omega, the boundaries'
            motion, the energy lost so far (J), and what ground and contacts remembered
    """

    def __init__(self, engine: "Engine"):
        self.keep(engine)

    def keep(self, engine: "Engine") -> None:
        """The present state of ``engine`` is sound."""
        state, contacts = engine.particles.read(), _contacts_on_file(engine)
        if contacts is None:  # forces are found anew
            del state["force"], state["torque"]
        self.known: dict[str, Any] = {
            "time": engine.step * engine.time_step,
            "step": engine.step,
            **state,
            "motion": engine.boundaries.read(),
            "lost": engine.lost + engine.energy.loss(False),
            **engine.ground.save(),
            "contacts": contacts,
        }

    def restore(self, engine: "Engine") -> None:
        """Have ``engine`` go back to it."""
        good = self.known
        engine.particles.write(good["position"], good["velocity"], good["omega"])
        engine.boundaries.write(good["motion"])
        engine.control.step[None] = good["step"]
        engine.ground.restore(good)
        if engine.sleep is not None:
            engine.sleep.wake_all(good["step"])
        engine.skin.start_again(good["step"])
        engine.rebuild(remember=False, filed=good["contacts"])
        engine.evaluate_at_rest()
        if good["contacts"] is not None:  # which forces at rest have changed
            engine.rebuild(remember=False, filed=good["contacts"])
            engine.particles.write_load(good["force"], good["torque"])
        engine.control.flags.fill(0)
        engine.lost = good["lost"] - engine.energy.loss(False)


def _contacts_on_file(engine: "Engine") -> tuple[np.ndarray, np.ndarray] | None:
    """What contacts remember, which friction, rolling, yielding or adhesion make them do; None at
    the start, where they only know what their forces at rest tell them."""
    remembers = engine.effects.history or engine.effects.adhesion
    if not remembers or engine.step == 0 or engine.particles.count > REMEMBERED:
        return None
    engine.neighbors.save(True)
    return engine.contacts.filed()
