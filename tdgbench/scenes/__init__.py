"""Input: scenes, views, cameras, sparse points; a loader per data set. Imports `files`, `ply` and `text` alone."""

from tdgbench.scenes.camera import Camera
from tdgbench.scenes.datasets import Dataset, FolderDataset, RegisteredDataset
from tdgbench.scenes.errors import MissingScenesError, SceneError
from tdgbench.scenes.options import Description, ReadOptions
from tdgbench.scenes.scene import PointCloud, Scene, TemperatureRange, View

__all__ = [
    "Camera",
    "Dataset",
    "Description",
    "FolderDataset",
    "MissingScenesError",
    "PointCloud",
    "ReadOptions",
    "RegisteredDataset",
    "Scene",
    "SceneError",
    "TemperatureRange",
    "View",
]
