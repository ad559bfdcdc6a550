"""safetensors: the weights of the networks, with a description that says how to evaluate them.

References:
    https://github.com/huggingface/safetensors
"""

from __future__ import annotations

import json
from pathlib import Path

from safetensors.torch import save

from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.export.network_format import DESCRIPTION
from nsm.types import Morph


def write_safetensors(path: Path | str, morph: Morph) -> None:
    """Write the weights of f and V in single precision, with their description as ``nsm.json`` in the metadata.

    ``field.0.weight`` (out, in), ``field.0.bias`` (out,), … and ``velocity.0.weight``, … are those of the layers from
    the first to the last, with ω folded in: h ↦ sin(W h + b), or another ``activation``, and W h + b at the end.

    Args:
        path: The file to write.
        morph: A morph of networks.

    Raises:
        InputError: If the morph is not made of networks alone, because its volume changes, it is symmetric, or its
            velocity is a formula, or the file cannot be written.
    """
    networks = morph.networks()
    if networks.weights is None:
        described = networks.description
        what, instead = f"the velocity {(described['velocity'] or {}).get('kind')}", ""
        if described["symmetry"]:
            what = "a symmetry"
        if described["grown"]:
            what, instead = "a changing volume", " or `growth=none`"
        raise InputError(
            f"`format` must be pt2 or onnx for a morph with {what}, which is a formula without weights, got "
            f"safetensors. Try `format=onnx`{instead}."
        )
    with atomic_write(path) as temporary:
        temporary.write_bytes(save(networks.weights, metadata={DESCRIPTION: json.dumps(networks.description)}))
