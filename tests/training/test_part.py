"""Parts of a training: networks and streams."""

import io

import pytest
import torch

from tdgbench.training.part import Network


def mlp() -> torch.nn.Module:
    torch.manual_seed(0)
    return torch.nn.Sequential(torch.nn.Linear(3, 8), torch.nn.BatchNorm1d(8), torch.nn.Linear(8, 1))


def take_steps(network: Network, first: int, last: int) -> None:
    """Train a network from an iteration to another one, on inputs that depend on the iteration alone."""
    for iteration in range(first, last + 1):
        network.begin(iteration)
        given = torch.rand(6, 3, generator=torch.Generator().manual_seed(iteration))
        (network.module(given) - given.sum(dim=1, keepdim=True)).square().mean().backward()
        assert network.step(iteration) is None


def stored(state):
    """A state as a checkpoint stores and reads it."""
    file = io.BytesIO()
    torch.save(state, file)
    file.seek(0)
    return torch.load(file, weights_only=True)


def bytes_of(network: Network) -> list[bytes]:
    return [tensor.numpy().tobytes() for tensor in network.module.state_dict().values()]


def test_a_network_resumes_to_the_same_bytes():
    """Weights, moments of Adam, and buffers, which are no parameters."""
    calm, killed, resumed = (Network(mlp(), 1e-2) for _ in range(3))
    take_steps(calm, 1, 20)
    take_steps(killed, 1, 9)
    assert bytes_of(killed) != bytes_of(calm)
    resumed.load_state_dict(stored(killed.state_dict()))
    take_steps(resumed, 10, 20)
    assert bytes_of(resumed) == bytes_of(calm)


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_a_gradient_or_a_parameter_that_is_not_finite_is_named_and_no_step_is_taken(value):
    network = Network(mlp(), 1e-2)
    take_steps(network, 1, 2)
    before = bytes_of(network)
    network.begin(3)
    network.module[0](torch.rand(6, 3)).sum().backward()
    network.module[0].bias.grad[2] = value
    assert network.step(3) == "0.bias" and bytes_of(network) == before and network.not_finite() is None
    network.module[2].weight.data[0, 3] = value
    assert network.not_finite() == "2.weight"


def test_gradients_of_an_iteration_are_forgotten_at_the_next_one():
    network = Network(mlp(), 1e-2)
    network.module(torch.rand(6, 3)).sum().backward()
    network.begin(2)
    before = [parameter.clone() for parameter in network.module.parameters()]
    assert network.step(2) is None  # of a backward pass that the network had no part in
    assert all(torch.equal(a, b) for a, b in zip(before, network.module.parameters(), strict=True))


def test_a_network_slows_down_and_keeps_the_last_factor():
    networks = [Network(mlp(), rate, torch.optim.SGD) for rate in (0.1, 0.01)]
    networks[0].set_slowdown(0.5)
    networks[0].set_slowdown(0.1)
    for network in networks:
        take_steps(network, 1, 3)
    assert bytes_of(networks[0]) == bytes_of(networks[1])


def test_what_is_stored_for_rendering_lacks_the_optimiser():
    network, again = Network(mlp(), 1e-2), Network(mlp(), 1e-2)
    take_steps(network, 1, 5)
    state = network.rendering_state()
    assert state.keys() == {"module"}
    for saved in (state, network.state_dict()):
        again.load_rendering_state(stored(saved))
        assert bytes_of(again) == bytes_of(network) and not again.optimizer.state_dict()["state"]
