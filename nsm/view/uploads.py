"""Files that a browser sends: limited in size, kept under safe names, and never more than read as shapes."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import viser
from viser import _messages

from nsm.cli.errors import InputError
from nsm.io.shape_file import ENDINGS

#: Kinds of files that the page takes: those that are plain data, but no weights, which are pickled.
_KINDS = ("mesh", "points", "labels", "silhouette")
#: Greatest length of the name of a file without its ending.
_LONGEST = 40
_MIB = 1 << 20
#: Makes the file inputs that viser hides behind its buttons visible, as areas that take dropped files as every file
#: input does. Should viser name them differently, the buttons remain.
DROP_AREAS = """<style>
div:has(> input[id^="file_upload_"]) { display: flex; flex-direction: column-reverse; position: relative; }
div:has(> input[id^="file_upload_"])::before {
  content: "or drop its file here"; position: absolute; bottom: 0; width: 100%; line-height: 2.6em; text-align: center;
  font-size: 0.85em; opacity: 0.7; pointer-events: none;
}
input[id^="file_upload_"] {
  display: block !important; box-sizing: border-box; width: 100%; height: 2.2em; margin-top: 0.3em; cursor: copy;
  border: 1px dashed #adb5bd; border-radius: 0.25em; color: transparent;
}
input[id^="file_upload_"]::file-selector-button { display: none; }
</style>"""


def limit_uploads(server: viser.ViserServer, limit: int, refused: Callable[[str, InputError], None]) -> None:
    """Drop uploads that are too large before anything of them is kept; viser has no option for this.

    Args:
        server: Server of the page.
        limit: Number of bytes.
        refused: Called with the identity of the button and the reason.
    """
    pending = server.gui._current_file_upload_states

    def check(client_id: int, message: _messages.FileTransferStartUpload) -> None:
        if message.transfer_uuid in pending and message.size_bytes > limit:
            del pending[message.transfer_uuid]  # viser drops what follows of it
            size, button = message.size_bytes, message.source_component_uuid
            # acknowledged, so that the page does not wait for it for ever
            server.gui._websock_interface.queue_message(
                _messages.FileTransferPartAck(button, message.transfer_uuid, size, size)
            )
            refused(button, too_large(str(message.filename), size, limit))

    server.gui._websock_interface.register_handler(_messages.FileTransferStartUpload, check)


def too_large(name: str, size: int, limit: int) -> InputError:
    """The error for a file of too many bytes, ready to be raised."""
    return InputError(
        f"`{safe_name(name)}` must be at most {limit / _MIB:g} MiB large, got {size / _MIB:.1f} MiB. Try a file with "
        "less detail, or start the page with a larger `upload`."
    )


def keep_upload(folder: Path, name: str, content: bytes) -> Path:
    """Write a file that was sent into a folder, and return where.

    Raises:
        InputError: If the ending of its name is not that of a kind that the page takes.
    """
    known = [ending for kind in _KINDS for ending in ENDINGS[kind]]
    if not name.lower().endswith(tuple(known)):
        kinds = "; ".join(f"{kind}: {', '.join(ENDINGS[kind])}" for kind in _KINDS)
        raise InputError(
            f"The name of a file must end as one of these kinds does ({kinds}), got `{safe_name(name)}`. Try a mesh "
            "such as `a.obj`."
        )
    path = folder / safe_name(name)
    path.write_bytes(content)
    return path


def safe_name(name: str) -> str:
    """Reduce the name of a file to letters, digits, and the dots of a known ending.

    >>> safe_name("../../my cow.nii.gz"), safe_name("$(rm -rf).obj"), safe_name("logo.exe")
    ('my_cow.nii.gz', 'rm_-rf.obj', 'logo.exe')
    """
    last = re.split(r"[/\\]", name)[-1]
    endings = sorted((ending for kind in ENDINGS.values() for ending in kind), key=len, reverse=True)
    ending = next((ending for ending in endings if last.lower().endswith(ending)), Path(last).suffix)
    stem = re.sub(r"[^A-Za-z0-9-]+", "_", last[: len(last) - len(ending)]).strip("_")
    return (stem[:_LONGEST] or "shape") + re.sub(r"[^a-z0-9.]", "", ending.lower())[:_LONGEST]
