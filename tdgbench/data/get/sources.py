"""Where the authors publish their data sets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.registry import DATASETS, SCENES

DRIVE_FOLDERS = "https://drive.google.com/drive/folders/"


class GetError(SceneError):
    """A data set cannot be fetched. The message names the file or the address, and the remedy."""


class BadFileError(GetError):
    """One file cannot be used; the others can still be fetched."""


@dataclass(frozen=True)
class PublishedDataset:
    """A published data set.

    folder: of the data set in a data root. identifier: of a Zenodo record or of a Google Drive folder. authors: whom to
    ask if it is gone.
    """

    dataset: str
    folder: str
    paper: str
    host: Literal["Zenodo", "Google Drive"]
    identifier: str
    authors: str

    @property
    def page(self) -> str:
        """The address for a browser."""
        return ("https://zenodo.org/records/" if self.host == "Zenodo" else DRIVE_FOLDERS) + self.identifier

    def scene(self, folder: str) -> str:
        """Return the name of a scene: the paper's for a name or alias of one of its scenes, else the folder's.

        >>> SOURCES["thermalmix"].scene("hands"), SOURCES["thermalmix"].scene("panel")
        ('Hand', 'panel')
        """
        known = (scene.name for scene in SCENES if scene.dataset == self.dataset and scene.matches(folder))
        return next(known, folder)


SOURCES = {
    source.dataset: source
    for source in (
        # mert-o/ThermalNeRFs, readme.md, d822bd1
        PublishedDataset("thermalmix", DATASETS["thermalmix"], "Özer et al. 2024", "Zenodo", "11065834",
               "github.com/mert-o/ThermalNeRFs"),
        # chen-hangyu/Thermal-Gaussian-main, README.md, 050c291; issue 14 (November 2025): the folder is gone
        PublishedDataset("rgbt_scenes", DATASETS["rgbt_scenes"], "Lu et al. 2024", "Google Drive",
               "1xuPwqezNW_LSB5C-H8TQFJ7nLoSS2BOg", "github.com/chen-hangyu/Thermal-Gaussian-main"),
        # Schindler-EPFL-Lab/thermo-nerf, README.md, 08d9be9
        PublishedDataset("thermoscenes", "ThermoScenes", "Hassan et al. 2024", "Zenodo", "10835108",
               "github.com/Schindler-EPFL-Lab/thermo-nerf"),
    )
}  # fmt: skip
