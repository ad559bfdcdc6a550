"""Shapes with exact signed distances, in 2D and 3D."""

from nsm.shapes.primitive.ball import Ball
from nsm.shapes.primitive.base import Primitive
from nsm.shapes.primitive.box import Box
from nsm.shapes.primitive.cylinder import Capsule, Cylinder
from nsm.shapes.primitive.polygon import Polygon
from nsm.shapes.primitive.torus import Torus
from nsm.shapes.primitive.union import Union

__all__ = ["Ball", "Box", "Capsule", "Cylinder", "Polygon", "Primitive", "Torus", "Union"]
