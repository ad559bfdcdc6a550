"""Morphs to measure, and their surfaces."""

from __future__ import annotations

from functools import partial

import torch
from problems import LinearMotion

from nsm.geometry.differences import finite_gradient
from nsm.geometry.meshing import extract_surface
from nsm.metrics import Protocol
from nsm.metrics.advection import check_advection
from nsm.metrics.surface import SurfaceFigures, surface_figures
from nsm.types import Morph

#: As coarse as figures of simple shapes allow.
COARSE = Protocol(volume_resolution=24, surface_resolution=24, times=3)


def surface_at(morph, time, resolution=32) -> SurfaceFigures:
    return surface_figures(morph, time, extract_surface(partial(morph, t=time), morph.bounds, resolution))


def meshes_of(morph, times, resolution):
    return [extract_surface(partial(morph, t=t), morph.bounds, resolution) for t in times]


def advected(morph, times, resolution):
    meshes = meshes_of(morph, times, resolution)
    return check_advection(morph, meshes[0], times, meshes, resolution)


class Still(Morph):
    """Shapes that a function of time and space gives, without velocity: nothing but a `Morph`."""

    def __init__(self, dim, field):
        self.dim, self.field = dim, field
        self.bounds = torch.tensor([[-1.0] * dim, [1.0] * dim], dtype=torch.double)
        self.source, self.target = partial(self, t=0.0), partial(self, t=1.0)
        self.provenance = {}

    def __call__(self, x, t):
        return self.field(x, t)

    def gradient(self, x, t):
        return finite_gradient(partial(self.field, t=t), x, 1e-6)


class Nothing(LinearMotion):
    """A morph that has collapsed: positive everywhere."""

    has_velocity = False

    def __call__(self, x, t):
        return super().__call__(x, t).abs() + 1

    def velocity(self, x, t):
        return None
