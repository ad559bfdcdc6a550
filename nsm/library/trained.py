"""A finished morph in the hands of its user: evaluated, meshed, measured, and saved."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
import trimesh
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.cli.settings import morph_time, morph_times, whole_number
from nsm.export.formats import FORMATS
from nsm.export.request import COORDINATES, Format, Request
from nsm.export.surfaces import similarity_to
from nsm.geometry.volume import volume
from nsm.io import checkpoint, official
from nsm.io.loading import exact_ends, known_ends
from nsm.io.timing import TimingLike, read_timing
from nsm.morphs.surfaces import extract_frame
from nsm.morphs.timing import Retimed
from nsm.plots.look import Look
from nsm.plots.strip import SUFFIXES as PICTURES
from nsm.plots.strip import render_strip
from nsm.render.film import SIZE, Pace, render_film
from nsm.render.film import SUFFIXES as FILMS
from nsm.shapes.download import file_sha256
from nsm.types import Key, Morph, Networks, SignedDistance, Times

#: Cells along the longest edge of the box on which surfaces are extracted.
RESOLUTION = 128
#: Frames of an animation, of a folder of meshes, and pictures of a strip.
FRAMES = 24
_CHECKPOINT = ".ckpt"
#: Suffixes of all files that `TrainedMorph.save` writes.
OUTPUTS = (_CHECKPOINT, *FILMS, *PICTURES, *(suffix for format in FORMATS.values() for suffix in format.suffixes))


class TrainedMorph(Morph):
    """A finished morph f(x, t) with what its user does with it.

    Args:
        morph: The morph that is evaluated, meshed, and filmed.
        network: The morph of the networks alone.
        content: What its checkpoint holds; empty for a published morph.
        identity: A name of the weights that no other morph has, such as the hash of its file.

    Attributes:
        dim: Dimension d of space.
        bounds: Corners of the box that holds the moving shape, shape (2, d), lowest first.
        network: The morph of the networks alone, without exact ends; for a method without a velocity it is the morph
            itself.
    """

    def __init__(self, morph: Morph, network: Morph, content: Mapping[str, Any], identity: str) -> None:
        self._morph, self.network, self._content, self._identity = morph, network, content, identity
        self.dim, self.bounds, self.provenance = morph.dim, morph.bounds, morph.provenance
        self.source, self.target = morph.source, morph.target

    def __call__(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"]:
        """Evaluate the signed distance at points x, shape (n, d), and times t, one number or shape (n,)."""
        return self._morph(x, t)

    def gradient(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"]:
        """Evaluate the spatial gradient of the signed distance, shape (n, d)."""
        return self._morph.gradient(x, t)

    def velocity(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"] | None:
        """Evaluate the velocity, shape (n, d), in units of length per unit of t; None for a method without one."""
        return self._morph.velocity(x, t)

    @property
    def keys(self) -> tuple[Key[SignedDistance], ...]:
        """Shapes that the morph passes through."""
        return self._morph.keys

    @property
    def has_velocity(self) -> bool:
        return self._morph.has_velocity

    def divergence(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"] | None:
        """Evaluate the divergence of the velocity in space, shape (n,); None for a method without a velocity."""
        return self._morph.divergence(x, t)

    def domain(self, t: float) -> Float[Tensor, "2 d"]:
        """Corners of the box in which f is known at time t, shape (2, d)."""
        return self._morph.domain(t)

    def wanted_volume(self, t: float, initial: float = 1.0) -> float:
        """Volume that the shape should have at time t, given the volume that it has at t = 0."""
        return self._morph.wanted_volume(t, initial)

    def networks(self) -> Networks:
        """The networks for other programs, with the ends that they have learned."""
        return self.network.networks()

    def mesh(self, t: float, resolution: int = RESOLUTION, coordinates: str = "morph") -> trimesh.Trimesh:
        """Extract the surface at one time as a triangle mesh.

        Args:
            t: Time in [0, 1].
            resolution: Cells along the longest edge of the box.
            coordinates: ``morph`` for the coordinates of the box; ``source`` or ``target`` for those of that shape's
                file, so that its pose and scale are undone.

        Returns:
            The mesh with vertex normals ∇f/‖∇f‖.

        Raises:
            InputError: If an argument is out of range, or the morph is two-dimensional.
        """
        if self.dim != 3:
            raise InputError(
                f"`mesh` must be called on a morph in 3D, got one in {self.dim}D. Try `nsm.extract_frame(morph, {t})`."
            )
        if coordinates not in COORDINATES:
            raise InputError(
                f"`coordinates` must be {', '.join(COORDINATES[:-1])} or {COORDINATES[-1]}, got {coordinates}. "
                "Try `coordinates='source'`."
            )
        time, resolution = morph_time("t", t), whole_number("resolution", resolution, 2)
        back = similarity_to(self._morph, coordinates)
        frame = extract_frame(self._morph, time, resolution)
        vertices, normals = back.apply(frame.mesh.vertices.double()), back.rotate(frame.normals.double())
        return trimesh.Trimesh(
            vertices.cpu().numpy(),
            frame.mesh.simplices.cpu().numpy(),
            vertex_normals=normals.cpu().numpy(),
            process=False,
        )

    def frames(
        self, count: int = FRAMES, resolution: int = RESOLUTION, coordinates: str = "morph"
    ) -> Iterator[trimesh.Trimesh]:
        """Extract the surface at evenly spaced times from t = 0 to 1, one at a time.

        Args:
            count: Number of times.
            resolution: Cells along the longest edge of the box.
            coordinates: Coordinates of the vertices, as for `mesh`.
        """
        times = morph_times("count", whole_number("count", count, 1))
        return (self.mesh(time, resolution, coordinates) for time in times)

    def volume(self, t: float, resolution: int = RESOLUTION) -> float:
        """Measure the volume (area in 2D) inside the surface at one time, from fractions of cells.

        Args:
            t: Time in [0, 1].
            resolution: Cells along the longest edge of the box.

        Returns:
            The volume in units of the box to the power d.
        """
        time, resolution = morph_time("t", t), whole_number("resolution", resolution, 2)
        return volume(partial(self._morph, t=time), self.bounds, resolution)

    def save(
        self,
        path: str | os.PathLike[str],
        frames: int = FRAMES,
        resolution: int = RESOLUTION,
        seconds: float = 4.0,
        size: Sequence[int] = SIZE,
        timing: TimingLike = "linear",
    ) -> Path:
        """Write the morph in the format that the suffix of ``path`` names.

        ====================================  =====================================================
        ``.ckpt``                             checkpoint that `load_morph` reads
        ``.mp4``, ``.gif``                    film of the surface above its volume
        ``.png``, ``.pdf``, ``.svg``          strip of pictures
        ``.glb``, ``.usd``                    animation of the surface for browsers and modeling programs
        ``.safetensors``, ``.pt2``, ``.onnx`` networks for programs
        no suffix                             folder of meshes, one PLY file per frame (OBJ in 2D)
        ====================================  =====================================================

        Args:
            path: File or folder to write; missing folders are made.
            frames: Number of evenly spaced times of an animation, a strip, or a folder.
            resolution: Cells along the longest edge of the box.
            seconds: Duration of an animation or a film.
            size: Width and height of a film in pixels.
            timing: Pace of the motion: ``linear``, ``smooth``, ``ease_in``, ``ease_out``, or pairs of film time and
                time of the morph from (0, 0) to (1, 1). It does not change a checkpoint.

        Returns:
            The path that was written.

        Raises:
            InputError: If the suffix is unknown, or the format cannot hold this morph.
        """
        path = Path(path)
        suffix, times = path.suffix.lower(), morph_times("frames", whole_number("frames", frames, 1))
        if suffix == _CHECKPOINT:
            return self._save_checkpoint(path)
        pace = read_timing(timing)
        morph, network = (each if pace is None else Retimed(each, pace) for each in (self._morph, self.network))
        if suffix in FILMS:
            render_film(path, morph, pace=Pace(seconds=seconds), size=size, look=Look(resolution=resolution))
            return path
        if suffix in PICTURES:
            render_strip(path, morph, times, look=Look(resolution=resolution))
            return path
        format = self._format(path)
        morph = network if format.holds_networks else morph
        identity = {"morph": self._identity, "exact": self._morph is not self.network, "timing": timing}
        advect = format.advects and self.has_velocity
        request = Request(morph, path, times, resolution, advect=advect, seconds=seconds, identity=identity)
        return format.export(request)

    def _format(self, path: Path) -> Format:
        """The format of a file by its suffix, or of a folder of meshes."""
        suffix = path.suffix.lower()
        for format in FORMATS.values():
            if self.dim in format.dims and (suffix in format.suffixes or not suffix):
                return format
        raise InputError(
            f"`path` must end in {', '.join(OUTPUTS)}, or in nothing for a folder of meshes, and hold a morph in "
            f"{self.dim}D, got {path}. Try `morph.save('morph.mp4')`."
        )

    def _save_checkpoint(self, path: Path) -> Path:
        if not self._content:
            raise InputError(
                "`path` of a published morph must not end in .ckpt, which holds networks of nsm only. "
                "Try `morph.save('morph.glb')`."
            )
        checkpoint.write_checkpoint(path, self._content[checkpoint.ENTRY], self._content["state_dict"])
        return path


def load_morph(path: str | os.PathLike[str], device: str | torch.device = "cpu", ends: str = "exact") -> TrainedMorph:
    """Load a trained morph for inference.

    Args:
        path: A checkpoint, or the folder of a run, whose ``checkpoints/best.ckpt`` is read.
        device: Where its networks are evaluated.
        ends: ``exact`` for the shapes themselves at their times (`nsm.ExactEnds`, `nsm.ExactKeys`), as every command
            shows them; ``network`` for the networks alone. Without a velocity, both are the networks.

    Raises:
        InputError: If there is no such checkpoint, or it cannot be read, or ``ends`` is neither.

    Example:
        >>> import nsm
        >>> morph = nsm.load_morph("outputs/demo")  # doctest: +SKIP
        >>> morph.volume(0.5)  # doctest: +SKIP
        0.2843
    """
    ends, read = known_ends(ends), checkpoint.open_checkpoint(path)
    network = checkpoint.restore_morph(read, device)
    content = {key: read.content[key] for key in (checkpoint.ENTRY, "state_dict")}
    exact = exact_ends(network, str(read.file)) if ends == "exact" else None
    return TrainedMorph(exact or network, network, content, file_sha256(read.file))


def load_official(name: str) -> TrainedMorph:
    """Load a morph that the authors of the method published, such as ``kitten_fandisk``, downloaded on first use.

    Raises:
        InputError: If no morph of that name was published, or it cannot be downloaded.
    """
    network = official.load_official(name)
    return TrainedMorph(network, network, {}, f"official/{official.official_name(name)}")
