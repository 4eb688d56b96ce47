from dataclasses import replace

import numpy as np
import pytest
import torch

from tdgbench.thermal.polynomials import TERMS
from tdgbench.training.embedding import EmbeddingRules, OwnVignettes

RULES = EmbeddingRules(size=3, hidden=5, scale=0.1, rate=0.02, after=0)
VIEWS, TARGET = 4, np.random.default_rng(5).normal(0, 0.05, (4, len(TERMS)))


def vignettes(seed=0, rules=RULES) -> OwnVignettes:
    return OwnVignettes(rules, VIEWS, len(TERMS), seed)


def moved(own: OwnVignettes) -> OwnVignettes:
    own.embeddings.values[:] = np.random.default_rng(1).normal(size=own.embeddings.values.shape)
    return own


def loss(own: OwnVignettes, index: int) -> float:
    return float(np.sum((own.of(index) - TARGET[index]) ** 2))


def fit(own: OwnVignettes, rounds: int) -> None:
    for index in np.random.default_rng(2).integers(VIEWS, size=rounds * VIEWS):
        own.step([(index, 2 * (own.of(index) - TARGET[index]))], 0.01, 0.0)
        own.center(np.ones(VIEWS, bool))


def test_a_view_starts_without_a_vignette_of_its_own():
    assert (vignettes().all() == 0).all() and vignettes().all().shape == (VIEWS, len(TERMS))


@pytest.mark.parametrize("part", range(4))
def test_gradients_are_those_of_finite_differences(part):
    own = moved(vignettes())
    gradient = own._gradients(2, 2 * (own.of(2) - TARGET[2]))[part]
    rows = list(own._rows.values())[part]
    values = rows.values[2] if part == 0 else rows.values[0]
    expected = np.zeros_like(values)
    for place in np.ndindex(values.shape):
        kept = values[place]
        ends = []
        for step in (1e-6, -1e-6):
            values[place] = kept + step
            ends.append(loss(own, 2))
        values[place] = kept
        expected[place] = (ends[0] - ends[1]) / 2e-6
    assert gradient == pytest.approx(expected, rel=1e-5, abs=1e-9)
    assert np.abs(gradient).max() > 1e-6


def test_steps_fit_the_vignettes_and_keep_the_mean_embedding():
    own = vignettes()
    before = sum(loss(own, index) for index in range(VIEWS))
    fit(own, 1500)
    assert sum(loss(own, index) for index in range(VIEWS)) < 0.1 * before
    assert own.embeddings.values.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)


def test_a_step_moves_the_embedding_of_its_view_alone():
    own = vignettes()
    own.step([(1, TARGET[1])], 0.01, 0.0)
    assert np.flatnonzero(own.embeddings.values.any(axis=1)).tolist() == [1]


def test_the_steps_of_one_iteration_have_the_gradients_of_its_start():
    both, one = moved(vignettes()), moved(vignettes())
    both.step([(0, TARGET[0]), (1, TARGET[1])], 0.02, 0.0)
    one.step([(1, TARGET[1])], 0.02, 0.0)
    assert np.array_equal(both.embeddings.values[1], one.embeddings.values[1])


def test_the_seed_decides_the_network():
    first, same, other = (moved(vignettes(seed)).of(0) for seed in (0, 0, 1))
    assert np.array_equal(first, same) and not np.allclose(first, other)


def test_the_scale_is_that_of_the_output():
    small, large = (moved(vignettes(rules=replace(RULES, scale=scale))).all() for scale in (0.1, 0.3))
    assert large == pytest.approx(3 * small)


def test_the_state_goes_on_where_it_was(tmp_path):
    own = vignettes()
    fit(own, 20)
    torch.save(own.state_dict(), tmp_path / "state.pt")
    again = vignettes(seed=9)
    again.load_state_dict(torch.load(tmp_path / "state.pt", weights_only=True))
    for one in (own, again):
        one.step([(3, TARGET[3])], 0.01, 0.001)
    assert np.array_equal(own.all(), again.all())
