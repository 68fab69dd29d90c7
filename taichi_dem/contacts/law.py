"""Composition of laws: one normal law, and the effects that the scene calls for beside it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from taichi_dem.contacts.cdt import CDT
from taichi_dem.contacts.cdt_jkr import CDTJKR
from taichi_dem.contacts.eepa import EEPA
from taichi_dem.contacts.hertz import Hertz
from taichi_dem.contacts.hooke import Hooke
from taichi_dem.contacts.jkr import JKR
from taichi_dem.contacts.mindlin import Mindlin
from taichi_dem.contacts.multicontact import MultiContact
from taichi_dem.validation import InputError, Problem

LAWS: dict[str, dict[str, type]] = {
    "normal": {"Hertz": Hertz, "Hooke": Hooke, "JKR": JKR, "EEPA": EEPA},
    "tangential": {"Mindlin": Mindlin},
    "rolling": {"CDT": CDT, "CDTJKR": CDTJKR},
    "surface": {"MultiContact": MultiContact},
}


@dataclass(frozen=True)
class Law:
    """The contact law of a scene.

    ``pairs`` maps two material names to laws of the same classes with other parameters:
    ``pairs={("glass", "gel"): {"tangential": Mindlin(friction=0.8)}}``.

    Raises ``InputError`` for a law in the wrong place, laws that do not go together, or a pair
    whose law is of another class or computes in another way (has other options).
    """

    normal: Any
    tangential: Any = None
    rolling: Any = None
    surface: Any = None
    pairs: Mapping[tuple[str, str], Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        problems = [p for slot in LAWS for p in self._slot_problems(slot)]
        problems += [
            p for names, laws in self.pairs.items() for p in self._pair_problems(names, laws)
        ]
        if not problems:
            problems = list(self._problems_together())
        if problems:
            raise InputError(problems)

    def parts(self) -> dict[str, Any]:
        """The laws in use: slot name to law."""
        return {slot: getattr(self, slot) for slot in LAWS if getattr(self, slot) is not None}

    def between(self, slot: str, first: str, second: str) -> Any:
        """The law of ``slot`` for materials named ``first`` and ``second``, in either order."""
        law = getattr(self, slot)
        for names in ((first, second), (second, first)):
            if slot in self.pairs.get(names, {}):
                law = self.pairs[names][slot]
        if isinstance(law, CDTJKR) and law.work_of_adhesion is None:
            normal = self.between("normal", first, second)
            return replace(law, work_of_adhesion=normal.work_of_adhesion)
        return law

    def without(self, *slots: str) -> "Law":
        """The same law with nothing in these ``slots``."""
        pairs = {
            names: {slot: law for slot, law in laws.items() if slot not in slots}
            for names, laws in self.pairs.items()
        }
        changed: dict[str, Any] = dict.fromkeys(slots)
        return replace(self, **changed, pairs=pairs)

    def idle(self, materials: Sequence[str]) -> dict[str, str]:
        """Slots whose law makes neither force nor torque between any two of these ``materials``
        (names), and why."""
        found = {}
        for slot, general in self.parts().items():
            if not hasattr(general, "idle"):
                continue
            laws = [self.between(slot, a, b) for a in materials for b in materials]
            reasons = dict.fromkeys(law.idle for law in laws)
            if all(reasons):
                found[slot] = f"{' or '.join(reasons)} for every pair of materials"
        return found

    def _slot_problems(self, slot: str) -> Iterable[Problem]:
        law, allowed = getattr(self, slot), LAWS[slot]
        if isinstance(law, tuple(allowed.values())) or (law is None and slot != "normal"):
            return
        names = ", ".join(allowed) or "left out (none is available yet)"
        yield Problem(slot, law, f"must be {'one of ' if allowed else ''}{names}")

    def _problems_together(self) -> Iterable[Problem]:
        """Adhesion energy is given once."""
        rows = {"rolling": self.rolling}
        rows |= {
            f"pairs[{names!r}].rolling": laws.get("rolling") for names, laws in self.pairs.items()
        }
        for path, law in rows.items():
            if not isinstance(law, CDTJKR):
                continue
            path, work = f"{path}.work_of_adhesion", law.work_of_adhesion
            if isinstance(self.normal, JKR) and work is not None:
                yield Problem(path, work, "must be left out: the normal law, JKR, has it")
            elif not isinstance(self.normal, JKR) and work is None:
                rule = (
                    "is missing; must be >= 0 J/m2, as the normal law, "
                    f"{type(self.normal).__name__}, has none (of JKR it would be taken)"
                )
                yield Problem(path, None, rule)

    def _pair_problems(self, names: Any, laws: Any) -> Iterable[Problem]:
        path = f"pairs[{names!r}]"
        if not (isinstance(names, tuple) and len(names) == 2):
            yield Problem(path, names, "must be a pair of material names")
            return
        if names != names[::-1] and names[::-1] in self.pairs and names > names[::-1]:
            yield Problem(path, names, "is given twice, in both orders")
        if not isinstance(laws, Mapping):
            rule = 'must map slots to laws, {"normal": ...} or {"tangential": ...}'
            yield Problem(path, laws, rule)
            return
        for slot, law in laws.items():
            if slot == "surface":
                rule = "must be left out: a surface law is that of a whole sphere"
                yield Problem(f"{path}.{slot}", law, rule)
                continue
            general = getattr(self, slot, None) if slot in LAWS else None
            if general is None:
                used = ", ".join(self.parts())
                yield Problem(f"{path}.{slot}", law, f"must name a law in use: {used}")
            elif type(law) is not type(general):
                expected = type(general).__name__
                yield Problem(f"{path}.{slot}", law, f"must be {expected}, as for all pairs")
            else:
                for name in getattr(law, "options", ()):
                    expected, value = getattr(general, name), getattr(law, name)
                    if value != expected:
                        rule = f"must be {expected!r}, as for all pairs"
                        yield Problem(f"{path}.{slot}.{name}", value, rule)
