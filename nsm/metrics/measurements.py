"""Everything measured on one morph, each part computed once, when it is first asked for."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial

from jaxtyping import Float
from torch import Tensor

from nsm.geometry.flow import FlowError
from nsm.geometry.jacobian import VolumeChange
from nsm.geometry.meshing import extract_surface, open_sides
from nsm.metrics.advection import AdvectionCheck, check_advection
from nsm.metrics.endpoint import EndpointErrors, endpoint_errors
from nsm.metrics.events import TopologyEvent, topology_events
from nsm.metrics.interior import interior_change
from nsm.metrics.landmarks import landmark_errors
from nsm.metrics.motion import Motion
from nsm.metrics.protocol import Protocol
from nsm.metrics.residuals import SpaceResiduals, space_residuals
from nsm.metrics.surface import SurfaceFigures, surface_figures
from nsm.metrics.volume_curve import VolumeCurve, times_through, volume_beyond, volume_curve
from nsm.shapes import FieldShape
from nsm.types import Morph, SimplexMesh

#: Number of stages that `Measurements` reports besides one for each key of the morph.
_STAGES = 6
#: What is advected, the surface and the points inside, has cells this many times as large as the grid of volumes.
_ADVECTED_COARSER = 2
#: Points on the surface for each point inside, which is advected with two neighbors for each axis.
_FEWER_INSIDE = 10


def stages(morph: Morph) -> int:
    """Number of stages that the measurements of a morph report."""
    return len(morph.keys) + _STAGES


class Measurements:
    """The parts of an evaluation that figures of merit share: volumes, surfaces, residuals, and their like.

    Args:
        morph: Morph to measure; its box ``morph.bounds`` is the unit of length and is covered by the grids.
        protocol: Resolutions and times.
        progress: Called with the name of each stage as it begins.
        flow_error: Measures the error of the flow maps that carry the detail of exact ends; None for other morphs.
    """

    def __init__(
        self,
        morph: Morph,
        protocol: Protocol,
        progress: Callable[[str], object],
        flow_error: Callable[[], FlowError] | None,
    ) -> None:
        self.morph, self.protocol = morph, protocol
        self._progress, self._flow_error = progress, flow_error
        self.times: list[float] = times_through(morph, protocol.times).tolist()

    @cached_property
    def volume(self) -> VolumeCurve:
        """Volume over time."""
        self._progress("volume over time")
        return volume_curve(self.morph, times_through(self.morph, self.protocol.times), self.protocol.volume_resolution)

    @cached_property
    def file_volume(self) -> float | None:
        """Volume of a unit cube of the box in the units of the source's file; None for a source without a file."""
        source = self.morph.source
        return source.similarity.scale**-self.morph.dim if isinstance(source, FieldShape) else None

    @cached_property
    def volume_beyond(self) -> float:
        """Greatest volume outside the box over V(0), at times when the surface leaves the box; 0 if it never does."""
        found = [
            volume_beyond(partial(self.morph, t=time), self.morph.bounds, self.protocol.volume_resolution)
            for time, mesh in zip(self.times, self.meshes, strict=True)
            if open_sides(mesh, self.morph.bounds)
        ]
        start = float(self.volume.volumes[0])
        return max(found, default=0.0) / start if start > 0 else float("nan")

    @cached_property
    def keys(self) -> tuple[EndpointErrors, ...]:
        """Deviation from each of the shapes at its time."""
        resolutions = self.protocol.surface_resolution, self.protocol.volume_resolution
        found = []
        for key in self.morph.keys:
            self._progress(f"surface at t = {key.time:g}")
            found.append(endpoint_errors(self.morph, key.time, key.shape, *resolutions))
        return tuple(found)

    def number(self, time: float) -> int:
        """Number of the time nearest to one, among those at which the morph is measured."""
        return min(range(len(self.times)), key=lambda number: abs(self.times[number] - time))

    def key(self, time: float) -> EndpointErrors:
        """Deviation from the shape of the key at a time."""
        return next(errors for errors in self.keys if errors.time == time)

    @cached_property
    def meshes(self) -> tuple[SimplexMesh, ...]:
        """Surface at each of the times."""
        self._progress("surface over time")
        return tuple(self._surface(time, self.protocol.volume_resolution) for time in self.times)

    @cached_property
    def surfaces(self) -> tuple[SurfaceFigures, ...]:
        """Properties of the surface at each of the times."""
        pairs = zip(self.times, self.meshes, strict=True)
        return tuple(surface_figures(self.morph, time, mesh, self.protocol.samples) for time, mesh in pairs)

    @property
    def motion(self) -> Motion:
        """Speed of the surface over time."""
        return Motion(self.times, [surface.speed for surface in self.surfaces])

    @cached_property
    def space(self) -> tuple[SpaceResiduals, ...]:
        """Residuals around the surface and in the box at each of the times."""
        self._progress("residuals in space")
        how = self.protocol.shell_width, self.protocol.samples
        return tuple(space_residuals(self.morph, time, *how) for time in self.times)

    @cached_property
    def events(self) -> tuple[TopologyEvent, ...]:
        """Changes of topology, in order of time."""
        meshes = self.meshes
        self._progress("changes of topology")
        return topology_events(self.morph, self.times, meshes, self.protocol.volume_resolution)

    @cached_property
    def advection(self) -> AdvectionCheck | None:
        """Advection of the source surface by V; None for a morph without velocity."""
        meshes = self.meshes
        self._progress("advection of the source")
        resolution = self.protocol.volume_resolution // _ADVECTED_COARSER
        source = self._surface(0.0, resolution)
        return check_advection(self.morph, source, self.times, meshes, resolution)

    @cached_property
    def landmarks(self) -> Float[Tensor, " k"] | None:
        """Distances of the advected landmarks from those of the target; None for a morph without landmarks."""
        return landmark_errors(self.morph)

    @cached_property
    def interior(self) -> VolumeChange | None:
        """Change of volumes inside under the flow of V; None for a morph without velocity."""
        self._progress("change of volume inside")
        return interior_change(self.morph, max(1, self.protocol.samples // _FEWER_INSIDE))

    @cached_property
    def flow(self) -> FlowError | None:
        """Error of the flow maps that carry the detail of exact ends; None for a morph without them."""
        return None if self._flow_error is None else self._flow_error()

    def free_meshes(self) -> None:
        """Free the surfaces over time, which take most of the memory; they are extracted anew if asked for again."""
        del self.meshes

    def _surface(self, time: float, resolution: int) -> SimplexMesh:
        return extract_surface(partial(self.morph, t=time), self.morph.bounds, resolution)
