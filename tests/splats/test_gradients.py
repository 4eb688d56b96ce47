import torch

from tdgbench.splats.gradients import Gradients


def test_dense_gradients_name_everyone():
    values, image = torch.rand(3, 16), torch.rand(3, 2)
    dense = Gradients.dense(values, image, torch.tensor([4, 0, 2], dtype=torch.int32))
    index, rows, on_image = dense.rows()
    assert index.tolist() == [0, 1, 2] and torch.equal(rows, values) and torch.equal(on_image[:, :2], image)
    assert [t.tolist() for t in dense.visible()] == [[0, 2], [4, 2]]


def sparse(index, seen, radii, columns: int, factor: float) -> Gradients:
    """Rows with an unused place before each piece."""
    room = torch.tensor([99, *index], dtype=torch.int32)
    values = factor * torch.ones(len(room), columns)
    return Gradients(
        [(1, len(index))], room, values, factor * torch.ones(len(room), 3), [(0, len(seen))],
        torch.tensor(seen, dtype=torch.int32), torch.tensor(radii, dtype=torch.int32),
    )  # fmt: skip


def test_the_sum_of_two_views():
    one, two = sparse([2, 0], [0, 2], [3, 4], 16, 1.0), sparse([2], [1, 2], [0, 9], 32, 10.0)
    assert Gradients.total([one], 4) is one
    total = Gradients.total([one, two], 4)
    assert total.values[:, 0].tolist() == [1, 0, 11, 0] and total.values[:, 20].tolist() == [0, 0, 10, 0]
    assert total.image[:, 1].tolist() == [1, 0, 11, 0] and total.radii.tolist() == [3, 0, 9, 0]
