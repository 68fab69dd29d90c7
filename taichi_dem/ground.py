"""The coupled substrate as a whole: who solves for its contacts, and what must be looked after
beside: dents that recover, and whether a lagged exchange still converges."""

import sys
from collections.abc import Callable, Sequence
from typing import Any

from taichi_dem.contact_list import ContactList
from taichi_dem.control import Control
from taichi_dem.creep import Creep
from taichi_dem.effects import Effects
from taichi_dem.exchange import Exchange
from taichi_dem.extrapolation import Extrapolation
from taichi_dem.hosted import NO_EQUILIBRIUM, HostedExchange
from taichi_dem.lagged import LaggedWatch
from taichi_dem.material import Material
from taichi_dem.particles import Particles
from taichi_dem.periodic import Period
from taichi_dem.substrate import Substrate
from taichi_dem.types import ti


class Ground:
    """Of a scene with ``substrate``; there is nothing to do where that is None or not coupled.

    exchange  the contacts with it; None if there is nothing to do, and so are the next two
    hosted    solves for those that the kernel does not
    lag       looks at the exchange if it is lagged, or is None
    """

    def __init__(
        self,
        substrate: Substrate | None,
        period: Period | None,
        particles: Particles,
        law: Any,
        effects: Effects,
        coefficients: Any,
        materials: Sequence[Material],
        control: Control,
        builder: "ti.FieldsBuilder",
    ):
        self.adhesion = effects.adhesion
        self.exchange: Exchange | None = None
        self.hosted: HostedExchange | None = None
        self.lag: LaggedWatch | None = None
        if substrate is None or substrate.exchange == "none":
            return
        self.exchange = Exchange(
            substrate, period, particles, law, effects, coefficients, materials, control, builder
        )
        self.hosted = HostedExchange(self.exchange, substrate.relaxation)
        if self.exchange.lagged:
            self.lag = LaggedWatch(self.exchange)
        self._may_diverge = substrate.force_lagged

    def fill(self) -> None:
        """Write the constants, after the fields have been placed."""
        if self.exchange is not None:
            self.exchange.fill()

    def restart(self) -> None:
        """As if no step had ever been made."""
        if self.hosted is not None:
            self.hosted.restart()
        if self.lag is not None:
            self.lag.restart()

    def save(self) -> dict[str, Any]:
        """What :meth:`restore` takes."""
        return {
            "creep": None if self.creep is None else self.creep.save(),
            "lag": None if self.lag is None else self.lag.save(),
        }

    def restore(self, saved: dict[str, Any]) -> None:
        """Go back to what was known then, and find the rest anew."""
        if self.exchange is not None:
            self.exchange.forget()
        if self.creep is not None:
            self.creep.restore(saved["creep"])
        if self.lag is not None:
            self.lag.restore(saved["lag"])

    def reorder(self, order: Any) -> None:
        """Follow the particles into the ``order`` of the cells."""
        if self.exchange is not None:
            self.exchange.reorder(order)

    def enrol(self, contacts: ContactList) -> None:
        """Find the contacts on a list that was made anew."""
        if self.exchange is not None:
            self.exchange.enrol(contacts)

    # -- steps -----------------------------------------------------------------------------------

    @property
    def host(self) -> HostedExchange | None:
        """Who solves for the contacts, if they are not for the kernel."""
        return self.hosted if self.exchange is not None and self.exchange.hosted else None

    @property
    def creep(self) -> Creep | None:
        """What a ground that creeps remembers."""
        return None if self.hosted is None else self.hosted.creep

    def solve(self, contacts: ContactList, time_step: float, settle: Callable[[], None]) -> None:
        """What the host has to do at a step; ``settle`` as in :meth:`HostedExchange.update`."""
        if self.host is not None:
            together = self.host.exchange.together
            self.host.update(contacts, time_step, settle if together else None)
        elif time_step > 0:
            self.let_dents_be(1, time_step)

    def let_dents_be(self, steps: int, time_step: float) -> None:
        """They recover, step by step, so that it does not matter how many are made at once."""
        if self.creep is not None:
            for _ in range(steps):
                self.creep.wait(time_step)

    def steps_alone(self, step: int, most: int) -> int:
        """How many, of at most ``most``, can be made from ``step`` on without the host."""
        return most if self.host is None else min(most, self.host.steps_to_next(step))

    @property
    def next_look(self) -> int:
        """The step of the next look at a lagged exchange."""
        return sys.maxsize if self.lag is None else self.lag.next

    def found_to_diverge(self, step: int) -> bool:
        """Whether a lagged exchange is to be stopped at this step, where its state is still sound:
        so that it depends on no clock where that is."""
        if self.lag is None or step < self.lag.next:
            return False
        self.lag.look(step)
        return self.lag.diverges and not self._may_diverge

    # -- looking ---------------------------------------------------------------------------------

    def note_stored(self) -> None:
        """What the surface holds; the solve in the kernel says so at every step."""
        if self.hosted is not None and (self.host is not None or self.creep is not None):
            self.hosted.note_energy()

    @property
    def in_dents(self) -> float:
        """J, stored where nobody presses any more, when last noted."""
        return 0.0 if self.hosted is None else self.hosted.in_dents

    @property
    def trouble(self) -> str:
        """Why the exchange has called for a stop."""
        if (between := self._lost_between) is not None:
            return between.reason()
        return NO_EQUILIBRIUM if self.host is None else self.host.trouble

    @property
    def setting_behind(self) -> tuple[str, Any] | None:
        """Which entry of the scene is behind that, and its value, if it is one."""
        between = self._lost_between
        return None if between is None else ("substrate.exchange_every", int(between.every[None]))

    @property
    def _lost_between(self) -> Extrapolation | None:
        """What carries the ground on between exchanges, if a contact swings too far meanwhile."""
        exchange = self.exchange
        if exchange is not None and exchange.extrapolates and exchange.between.lost:
            return exchange.between
        return None

    def doubts(self) -> dict[str, int]:
        """How often so far what its model assumes did not hold, by name."""
        counts = {} if self.exchange is None else self.exchange.doubts.counts()
        return counts if self.lag is None else {**counts, "lagged_exchange": self.lag.risky}

    def margins(self) -> dict[str, float]:
        """How far its cheaper ways have been from failing."""
        if self.lag is not None:
            return {"lagged_spectral_radius": self.lag.largest}
        if self.exchange is not None and self.exchange.extrapolates:
            return {"exchange_phase": float(self.exchange.between.largest[None])}
        return {}
