"""The study of a scene whose trajectories part: spheres that tumble in a box."""

import numpy as np
import pytest
from setups import law, scene

import taichi_dem as dem
from taichi_dem import accuracy, study_bench
from taichi_dem.record import Record, even_step, record
from taichi_dem.studies import study
from taichi_dem.study_point import STATISTICS, TARGETS, pareto

R = 2e-3
SOFT = dem.Material("soft", density=1000, youngs_modulus=5e5, poissons_ratio=0.3)
MEMBERS = 12
DURATION = 0.2  # s, in which the runs of an ensemble part as far as they can


def tumbling(side=3):
    """Soft spheres thrown about in an open box."""
    rng = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(*[np.arange(side)] * 3), axis=-1).reshape(-1, 3)
    place = R * (1.2 + 2.4 * grid + rng.uniform(-0.1, 0.1, grid.shape))
    width = 2.4 * side * R
    return scene(
        place,
        R,
        SOFT,
        velocity=rng.normal(0, 0.3, grid.shape),
        law=law(0.9),
        boundaries=[dem.Box((0, 0, 0), (width, width, np.inf), SOFT)],
        gravity=(0, 0, -9.81),
    )


class Within:
    """A worker in this process: one compilation does for all steps. A run takes as long as it has
    steps."""

    built = 0.0

    def __init__(self, sim, settings, window, samples, step):
        self.sim, self.window, self.samples = sim, window, samples
        self.stable = sim.stable.value
        self.step = step or self.stable

    def look(self, save, member=0, step=None):
        self.sim.restart(
            accuracy.perturbed(tumbling().spheres, member),
            dt=even_step(step or self.step, self.window, self.samples),
        )
        record(self.sim, self.window, self.samples).save(save)
        return {"hosted": False}

    def time(self, step=None):
        return self.window / (step or self.step)

    def close(self):
        pass


@pytest.fixture(scope="module")
def sim():
    return dem.Simulation(tumbling())


@pytest.fixture(scope="module")
def studied(sim, tmp_path_factory):
    """The study and what it said."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study_bench, "Worker", lambda path, *rest: Within(sim, *rest))
        patch.setattr(study_bench, "MEMBERS", MEMBERS)
        folder, said = tmp_path_factory.mktemp("chaos") / "out", []
        found = study(tumbling(), folder, ["step"], DURATION, rounds=1, samples=64, say=said.append)
    return found, said


def ensemble(found, name):
    paths = [found.folder / "records" / f"{name}.{member}.npz" for member in range(MEMBERS)]
    return [Record.load(path) for path in paths]


def gyration(runs):
    """The radius of gyration at the end, of each."""
    ends = np.array([run.position[-1] for run in runs])
    return np.sqrt(ends.var(axis=1).sum(axis=1))


@pytest.mark.slow
def test_a_chaotic_scene_is_known_as_one(studied):
    found, _ = studied
    reference = found.reference
    assert found.chaotic and reference.members == MEMBERS and reference.touched
    assert 0 < reference.last < found.samples
    one, other = ensemble(found, "reference")[:2]
    apart = np.linalg.norm(one.position - other.position, axis=(1, 2))
    assert apart[-1] > 1e3 * accuracy.GROWTH * apart[0]


@pytest.mark.slow
def test_errors_are_those_of_means_with_their_standard_uncertainty(studied):
    """Computed once more from the runs on record; the closed form has no part in it."""
    found, _ = studied
    there = gyration(ensemble(found, "reference"))
    for number, point in enumerate(found.points):
        here = gyration(ensemble(found, number))
        error = abs(here.mean() - there.mean()) / there.mean()
        doubt = np.sqrt((here.var(ddof=1) + there.var(ddof=1)) / MEMBERS) / there.mean()
        doubt *= accuracy.apart(ensemble(found, number), ensemble(found, "reference"))
        assert point.means["radius of gyration"] == pytest.approx((error, doubt), rel=1e-6)
        assert set(point.means) == set(STATISTICS) - {"depression"}
        assert (point.error, point.uncertainty) in point.means.values()
        assert point.error == max(error for error, _ in point.means.values())
        assert point.bound == max(error + 2 * doubt for error, doubt in point.means.values())
        assert "rebound" not in point.errors


@pytest.mark.slow
def test_the_uncertainty_falls_as_the_root_of_the_number_of_runs(studied, monkeypatch):
    """The scatter of three ensembles of four is that of one of twelve."""
    found, _ = studied
    monkeypatch.setattr(accuracy, "apart", lambda *_: 1.0)
    references = ensemble(found, "reference")
    for number in range(len(found.points)):
        runs = ensemble(found, number)
        all_of_them = accuracy.ensemble_errors(runs, references)
        parts = [
            accuracy.ensemble_errors(runs[k : k + 4], references[k : k + 4])
            for k in range(0, MEMBERS, 4)
        ]
        for name, (_, doubt) in all_of_them.items():
            few = np.sqrt(np.mean([part[name][1] ** 2 for part in parts]))
            assert 0.7 < few / (np.sqrt(3) * doubt) < 1.15


@pytest.mark.slow
@pytest.mark.parametrize("duration", [0.04, 0.08, DURATION])
def test_errors_of_fine_steps_are_as_large_as_they_are_said_to_be(sim, tmp_path, duration):
    """Also while the runs of an ensemble are still much nearer to each other than to those at
    another step."""

    def runs(step, name):
        worker = Within(sim, None, duration, 8, step)
        paths = [tmp_path / f"{name}.{member}.npz" for member in range(study_bench.MEMBERS)]
        for member, path in enumerate(paths):
            worker.look(path, member)
        return [Record.load(path) for path in paths]

    stable = sim.stable.value
    references, ratios = runs(stable / 16, "reference"), []
    for finer in range(5, 10):
        found = accuracy.ensemble_errors(runs(stable / finer, finer), references)
        ratios += [error / doubt for error, doubt in found.values()]
    assert 0.2 < np.sqrt(np.mean(np.square(ratios))) < 1.5
    assert np.mean(np.array(ratios) < 2) > 0.8


@pytest.mark.slow
def test_only_what_is_beyond_the_uncertainty_is_claimed(studied):
    found, said = studied
    assert said == [*said[: -len(lines(found))], *lines(found)]
    assert lines(found)[0].startswith("chaotic: trajectories stay comparable over ")
    assert f"an ensemble of {MEMBERS} perturbed runs" in lines(found)[0]
    (orders,) = (line for line in lines(found) if line.startswith("orders"))
    assert " in the first " in orders and "200 ms" not in orders
    for line, target in zip(lines(found)[-len(TARGETS) :], TARGETS, strict=True):
        meeting = [p for p in found.points if all(e + 2 * u <= target for e, u in p.means.values())]
        assert line.startswith(f"error {target:g}: ")
        assert ("is the cheapest" in line) == bool(meeting)
    bounds = [point.bound for point in pareto(found.points)]
    assert bounds == sorted(bounds, reverse=True)
    assert "met by none" in said[-1] and said[-1].endswith(f"could be told from {MEMBERS} runs")


def lines(found):
    return (found.folder / "study.txt").read_text().splitlines()
