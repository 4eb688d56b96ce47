"""Radiance fields: hash grid, networks, region of a scene, samplers, volume rendering; no configuration, no scene."""

from tdgbench.fields.adam import FieldAdam
from tdgbench.fields.contraction import Region, region_of
from tdgbench.fields.density import DensityField, GridOptions
from tdgbench.fields.hash_grid import HashGrid
from tdgbench.fields.networks import MLP, encoded_directions
from tdgbench.fields.occupancy import OccupancyGrid, march
from tdgbench.fields.proposals import Sampler, annealed, proposal_loss
from tdgbench.fields.rays import Rays, image_rays, rays_of
from tdgbench.fields.sampling import distortion_loss
from tdgbench.fields.visible import visible_cells

__all__ = [
    "MLP", "DensityField", "FieldAdam", "GridOptions", "HashGrid", "OccupancyGrid", "Rays", "Region",
    "Sampler", "annealed", "distortion_loss", "encoded_directions", "image_rays", "march", "proposal_loss", "rays_of",
    "region_of", "visible_cells",
]  # fmt: skip
