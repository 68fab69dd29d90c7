"""The numbers that laws compute with, for every pair of a scene's materials."""

from collections.abc import Mapping, Sequence

from taichi_dem.contacts.law import Law
from taichi_dem.material import Material
from taichi_dem.types import real, ti


class Coefficients:
    """Per pair of materials, the numbers that one law computes with."""

    def __init__(self, law: Law, slot: str, materials: Sequence[Material]):
        self._law, self._slot, self._materials = law, slot, materials

    def between(self, a: Material, b: Material) -> Mapping[str, float]:
        """The coefficients of materials ``a`` and ``b``."""
        return self._law.between(self._slot, a.name, b.name).coefficients(a, b)

    def place(self, builder: "ti.FieldsBuilder") -> None:
        """Make the table, for kernels."""
        names = getattr(self._law, self._slot).coefficient_names
        self.table = ti.Struct.field(dict.fromkeys(names, real))
        builder.dense(ti.ij, len(self._materials)).place(self.table)

    def fill(self) -> None:
        """Write the table, after it has been placed."""
        for row, a in enumerate(self._materials):
            for column, b in enumerate(self._materials):
                self.table[row, column] = dict(self.between(a, b))
