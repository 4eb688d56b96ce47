"""The comparison finds wrong kernels."""

import torch

from tdgbench.experiments.stress import compare


def spoiled(monkeypatch, change):
    original = compare.render

    def render(scene, backend, *rest):
        image, gradients = original(scene, backend, *rest)
        return change(image, gradients) if backend == "cpu" else (image, gradients)

    monkeypatch.setattr(compare, "render", render)
    return compare.compared(compare.cloud(30), "cpu").numbers


def test_a_sound_core():
    numbers = compare.compared(compare.cloud(30), "cpu").numbers
    assert numbers["image"] < 1e-6 and numbers["gradients"] < 1e-5


def test_a_wrong_pixel(monkeypatch):
    def change(image, gradients):
        image[3, 4, 0] += 0.01
        return image, gradients

    assert 0.009 < spoiled(monkeypatch, change)["image"] < 0.011


def test_a_wrong_gradient(monkeypatch):
    def change(image, gradients):
        return image, {**gradients, "scales": 1.01 * gradients["scales"]}

    assert 0.009 < spoiled(monkeypatch, change)["gradients"] < 0.011


def test_nan(monkeypatch):
    numbers = spoiled(monkeypatch, lambda image, gradients: (image * torch.nan, gradients))
    assert numbers["image"] != numbers["image"]
