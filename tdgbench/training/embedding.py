"""A vignette of each view's own, made from an embedding of the view by a tiny network that all views share.

The vignette of an uncooled camera changes with the temperature of its housing, so that each view may have another one.
Views share the few numbers behind it: coefficients_v = scale · B (tanh(A e_v + a) − tanh(a)) of the polynomials of
`tdgbench.thermal.polynomials`, with an embedding e_v of each view v. Embeddings of views that are learned with the
scene are those of NeRF in the Wild (Martin-Brualla et al. 2021), there as an input of the network that renders.

Embeddings start at 0, which makes no vignette, and their mean stays 0. A polynomial's mean over the image is 0, so that
an embedding moves no mean temperature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field, NonNegativeFloat

from tdgbench.training.learned import LearnedRows

STREAM = 7  # of random numbers, beside those of other uses of the seed


@dataclass(frozen=True)
class EmbeddingRules:
    """Embeddings of the views, and their network."""

    size: Annotated[int, Field(ge=1, le=64)]  # numbers of a view
    hidden: Annotated[int, Field(ge=1, le=256)]  # units of the network's one hidden layer
    scale: Annotated[float, Field(gt=0, le=1)]  # image values, standard deviation over the image, of an output of 1
    rate: NonNegativeFloat  # Adam's at the start, of embeddings and network; it falls as those of `Refinement`
    after: NonNegativeFloat  # rounds of all views before they are learned


class OwnVignettes:
    """Coefficients (K,) of the vignettes of V views, by embeddings (E,) and a network; float64, on the CPU."""

    def __init__(self, rules: EmbeddingRules, views: int, outputs: int, seed: int) -> None:
        """outputs: K. seed: of the network's first weights."""
        size, hidden = rules.size, rules.hidden
        random = np.random.default_rng([seed, STREAM])
        self._scale = rules.scale
        self._rows = {
            "embeddings": LearnedRows(np.zeros((views, size))),
            "inner": LearnedRows(random.normal(0, size**-0.5, (1, hidden, size))),  # A
            "bias": LearnedRows(random.normal(0, 1, (1, hidden))),  # a
            "outer": LearnedRows(random.normal(0, hidden**-0.5, (1, outputs, hidden))),  # B
        }
        self.embeddings, self._inner, self._bias, self._outer = self._rows.values()

    def of(self, index: int) -> np.ndarray:
        """Coefficients (K,) of a view's vignette, image values."""
        inside, at_rest = self._hidden(index)
        coefficients: np.ndarray = self._scale * self._outer.values[0] @ (inside - at_rest)
        return coefficients

    def all(self) -> np.ndarray:
        """Coefficients (V, K) of all views."""
        return np.stack([self.of(index) for index in range(len(self.embeddings.values))])

    def step(self, by_outputs: Sequence[tuple[int, np.ndarray]], rate: float, decay: float) -> None:
        """Adam's steps of embeddings and network, for losses of views (index) with gradients (K,) by `of(index)`."""
        gradients = [(index, self._gradients(index, by_output)) for index, by_output in by_outputs]
        for index, parts in gradients:
            for rows, row, gradient in zip(self._rows.values(), (index, 0, 0, 0), parts, strict=True):
                rows.step(row, gradient, rate, decay)

    def center(self, which: np.ndarray) -> None:
        """Make the mean embedding of some views, (V,) bool, 0."""
        self.embeddings.values[which] -= self.embeddings.values[which].mean(axis=0)

    def state_dict(self) -> dict[str, Any]:
        """Everything that training changes, as `torch.save` takes it."""
        return {name: rows.state_dict() for name, rows in self._rows.items()}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        for name, rows in self._rows.items():
            rows.load_state_dict(saved[name])

    def _hidden(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """The hidden layer (hidden,) for a view's embedding, and for embedding 0."""
        bias = self._bias.values[0]
        return np.tanh(self._inner.values[0] @ self.embeddings.values[index] + bias), np.tanh(bias)

    def _gradients(self, index: int, by_output: np.ndarray) -> tuple[np.ndarray, ...]:
        """Gradients by a view's embedding (E,), and by A, a and B."""
        inside, at_rest = self._hidden(index)
        by_inside = self._scale * by_output @ self._outer.values[0]
        by_sum = by_inside * (1 - inside**2)
        return (
            by_sum @ self._inner.values[0],
            np.outer(by_sum, self.embeddings.values[index]),
            by_sum - by_inside * (1 - at_rest**2),
            self._scale * np.outer(by_output, inside - at_rest),
        )
