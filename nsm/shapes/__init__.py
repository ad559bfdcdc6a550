"""Shapes that a morph passes through."""

from nsm.shapes.alignment import Aligned, Alignment, RigidAlignment, SharedCoordinates, SimilarityAlignment, Unaligned
from nsm.shapes.base import FieldShape, Shape, working_box
from nsm.shapes.download import fetch, resolve
from nsm.shapes.labels import LabelVolume
from nsm.shapes.landmarks import LandmarkPairs, LandmarkPoints, Landmarks, LandmarkTable, LandmarkVertices
from nsm.shapes.mesh import MeshFile, MeshShape
from nsm.shapes.normalize import EqualVolume, Placed, equal_volume, place_together
from nsm.shapes.outline import OutlineShape
from nsm.shapes.points import PointCloud
from nsm.shapes.primitive import Ball, Box, Capsule, Cylinder, Polygon, Primitive, Torus, Union
from nsm.shapes.silhouette import Silhouette
from nsm.shapes.similarity import Similarity
from nsm.shapes.siren import SirenShape
from nsm.shapes.siren_file import SirenFile

__all__ = [
    "Aligned",
    "Alignment",
    "Ball",
    "Box",
    "Capsule",
    "Cylinder",
    "EqualVolume",
    "FieldShape",
    "LabelVolume",
    "LandmarkPairs",
    "LandmarkPoints",
    "LandmarkTable",
    "LandmarkVertices",
    "Landmarks",
    "MeshFile",
    "MeshShape",
    "OutlineShape",
    "Placed",
    "PointCloud",
    "Polygon",
    "Primitive",
    "RigidAlignment",
    "Shape",
    "SharedCoordinates",
    "Silhouette",
    "Similarity",
    "SimilarityAlignment",
    "SirenFile",
    "SirenShape",
    "Torus",
    "Unaligned",
    "Union",
    "equal_volume",
    "fetch",
    "place_together",
    "resolve",
    "working_box",
]
