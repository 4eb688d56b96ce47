"""Small fully connected networks of radiance fields, and the encoding of directions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.scratch import Workspace
from tdgbench.splats.harmonics import sh_basis

PIECE = 4096  # rows of a batch that stay in the cache from the first layer to the last
ALIGNED = 8  # columns; matrix products with 15 take three times as long as with 16
LARGEST_EXPONENT = 15.0  # beyond which, to both sides, the gradient of `truncated_exp` changes no more


class MLP(nn.Module):
    """Linear layers without biases, with ReLU between them, as the fully fused networks of instant-ngp.

    float32 on the CPU goes through all layers in pieces of rows, and likewise back: large batches leave the cache
    otherwise. All else runs in plain torch.
    """

    def __init__(self, sizes: Sequence[int], generator: torch.Generator, sigmoid: bool = False) -> None:
        """sizes: of the input, the hidden layers and the output. sigmoid: of the output."""
        super().__init__()
        self.sigmoid, self.weights = sigmoid, nn.ParameterList()
        for columns, rows in pairwise(sizes):
            bound = (6 / (rows + columns)) ** 0.5  # Glorot and Bengio (2010, eq. 16)
            self.weights.append(nn.Parameter(bound * (2 * torch.rand(rows, columns, generator=generator) - 1)))

    def forward(self, rows: Tensor) -> Tensor:
        """Return the outputs (N, D) of rows (N, C)."""
        weights = list(self.weights)
        if rows.device.type == "cpu" and rows.dtype == weights[0].dtype == torch.float32:
            missing = -rows.shape[1] % ALIGNED
            if missing:
                rows, weights[0] = functional.pad(rows, (0, missing)), functional.pad(weights[0], (0, missing))
            out: Tensor = _InPieces.apply(self.sigmoid, rows, *weights)
            return out
        for weight in weights[:-1]:
            rows = functional.relu(rows @ weight.T)
        out = rows @ weights[-1].T
        return torch.sigmoid(out) if self.sigmoid else out


class _InPieces(torch.autograd.Function):
    """Rows (N, C) and the weights of layers to outputs (N, D)."""

    @staticmethod
    def forward(ctx: Any, sigmoid: bool, rows: Tensor, *weights: Tensor) -> Tensor:
        workspace = Workspace()
        hidden = [_taken(workspace, f"layer {i}", len(rows), len(weight)) for i, weight in enumerate(weights[:-1])]
        out = torch.empty(len(rows), len(weights[-1]))
        transposed = [weight.detach().T for weight in weights]

        def run(piece: slice) -> None:
            inputs = rows[piece]
            for weight, layer in zip(transposed[:-1], hidden, strict=True):
                inputs = torch.mm(inputs, weight, out=layer[piece]).relu_()
            torch.mm(inputs, transposed[-1], out=out[piece])
            if sigmoid:
                out[piece].sigmoid_()

        _run_pieces(run, len(rows))
        ctx.save_for_backward(*([out] if sigmoid else []), rows, *weights)
        ctx.sigmoid, ctx.hidden, ctx.workspace = sigmoid, hidden, workspace
        return out

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        *out, rows = ctx.saved_tensors[: 1 + ctx.sigmoid]
        weights = ctx.saved_tensors[1 + ctx.sigmoid :]
        layers, workspace = [rows, *ctx.hidden], ctx.workspace
        of_rows = torch.empty_like(rows) if ctx.needs_input_grad[1] else None
        pieces = -(-len(rows) // PIECE)
        parts = [_taken(workspace, f"gradient {i}", pieces, *weight.shape) for i, weight in enumerate(weights)]

        def run(piece: slice) -> None:
            gradient = gradients[0][piece]
            if ctx.sigmoid:
                gradient = torch.ops.aten.sigmoid_backward(gradient, out[0][piece])
            for i in range(len(weights) - 1, -1, -1):
                inputs = layers[i][piece]
                torch.mm(gradient.T, inputs, out=parts[i][piece.start // PIECE])
                if i > 0:
                    gradient = gradient @ weights[i]
                    torch.ops.aten.threshold_backward.grad_input(gradient, inputs, 0, grad_input=gradient)
                elif of_rows is not None:
                    torch.mm(gradient, weights[0], out=of_rows[piece])

        _run_pieces(run, len(rows))
        return None, of_rows, *(part.sum(dim=0) for part in parts)


def _taken(workspace: Workspace, role: str, *shape: int) -> Tensor:
    return torch.from_numpy(workspace.take(f"network {role}", shape, np.float32))


def _run_pieces(run: Callable[[slice], None], rows: int) -> None:
    """Run a function on all pieces of rows. Every thread has each n-th piece."""
    threads = pool.threads_for(rows, PIECE)

    def run_share(first: int) -> None:
        with torch.no_grad():  # a setting of the thread
            for start in range(first * PIECE, rows, threads * PIECE):
                run(slice(start, min(start + PIECE, rows)))

    pool.run(run_share, [(thread,) for thread in range(threads)])


class _TruncatedExp(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return x.exp()

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        (x,) = ctx.saved_tensors
        return gradients[0] * x.clamp(-LARGEST_EXPONENT, LARGEST_EXPONENT).exp()


def truncated_exp(x: Tensor) -> Tensor:
    """Return exp(x), whose gradient is exp(clamp(x, −15, 15)), as densities of torch-ngp and nerfacto."""
    result: Tensor = _TruncatedExp.apply(x)
    return result


def encoded_directions(directions: Tensor) -> Tensor:
    """Return the harmonics up to degree 3 (N, 16) of directions (N, 3) of any length (Müller et al. 2022, §5.4)."""
    return sh_basis(functional.normalize(directions, dim=-1), 3)
