"""Shapes: what a morph goes from and to."""

from nsm.shapes.base import FieldShape, Shape, working_box
from nsm.shapes.download import fetch, resolve
from nsm.shapes.landmarks import LandmarkPairs, Landmarks, LandmarkTable, LandmarkVertices
from nsm.shapes.mesh import MeshFile
from nsm.shapes.normalize import EqualVolume, equal_volume
from nsm.shapes.points import PointCloud
from nsm.shapes.primitive import Ball, Box, Capsule, Cylinder, Polygon, Primitive, Torus, Union
from nsm.shapes.similarity import Similarity
from nsm.shapes.siren_file import SirenFile, SirenShape

__all__ = [
    "Ball",
    "Box",
    "Capsule",
    "Cylinder",
    "EqualVolume",
    "FieldShape",
    "LandmarkPairs",
    "LandmarkTable",
    "LandmarkVertices",
    "Landmarks",
    "MeshFile",
    "PointCloud",
    "Polygon",
    "Primitive",
    "Shape",
    "Similarity",
    "SirenFile",
    "SirenShape",
    "Torus",
    "Union",
    "equal_volume",
    "fetch",
    "resolve",
    "working_box",
]
