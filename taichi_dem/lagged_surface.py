"""The surface as the forces of the step before leave it: no equilibrium is sought."""

from taichi_dem.coupled_contacts import DONE, START, CoupledContacts
from taichi_dem.types import ti


@ti.data_oriented
class LaggedSurface(CoupledContacts):
    """As ``CoupledContacts``, gone through like ``CoupledSolve``, with one evaluation."""

    @ti.func
    def proceed(self, law: ti.template()) -> ti.i32:
        """Go on after all blocks are done; there is always an answer."""
        if self.phase[None] == START:
            k = 0
            while k < self.count[None]:
                self.meet(k)
                k += 1
            self.call_evaluation()
        else:
            k = 0
            while k < self.count[None]:
                self.effective[k] = self.reached(k)
                k += 1
            self.load(law)
            self.phase[None] = DONE
        return 1
