"""Public data by name: looked for under NSM_DATA_DIR, else downloaded once, and always checked."""

from __future__ import annotations

import csv
import hashlib
import logging
import os
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from nsm.cli.errors import InputError

log = logging.getLogger(__name__)

#: Seconds to wait for a server.
TIMEOUT = 10


class Entry(NamedTuple):
    """A line of the manifest."""

    path: str
    bytes: int
    sha256: str
    url: str


@cache
def manifest() -> dict[str, Entry]:
    """The files that nsm knows by name, from ``manifest.tsv`` beside this module."""
    with files("nsm.shapes").joinpath("manifest.tsv").open(encoding="utf-8") as lines:
        rows = csv.DictReader(lines, delimiter="\t")
        return {row["path"]: Entry(row["path"], int(row["bytes"]), row["sha256"], row["url"]) for row in rows}


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's content, in hex."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def fetch(name: str) -> Path:
    """A checked local copy of a file of the manifest.

    Args:
        name: a path of the manifest, such as ``official/ni/kitten.pth``.

    Raises:
        InputError: if the name is unknown, a copy has another checksum, or there is neither copy nor network.
    """
    entry = manifest().get(name)
    if entry is None:
        near = get_close_matches(name, manifest(), n=3)
        hint = f"did you mean {' or '.join(near)}" if near else "see nsm/shapes/manifest.tsv for the names"
        raise InputError(f"{name} is not among the public files that nsm knows: {hint}?")
    root = os.environ.get("NSM_DATA_DIR")
    if root and (local := Path(root).expanduser() / entry.path).is_file():
        if (found := file_sha256(local)) != entry.sha256:
            raise InputError(
                f"{local} is not the file it should be (SHA-256 {found[:12]}…, expected {entry.sha256[:12]}…): "
                f"replace it by {entry.url}, or delete it to have it downloaded."
            )
        return local
    return _download(entry)


def resolve(path: str | os.PathLike[str]) -> Path:
    """A file that exists: the local one of that path, else the public one of that name.

    Raises:
        InputError: if there is neither, or the path is a folder.
    """
    local = Path(path).expanduser()
    if local.is_file():
        return local
    if local.is_dir():
        raise InputError(f"{local} is a folder: give the path of one file in it.")
    if str(path) in manifest():
        return fetch(str(path))
    near = get_close_matches(str(path), manifest(), n=1)
    raise InputError(
        f"There is no file {local}: give the path of an existing file"
        + (f" or a public name such as {near[0]}." if near else ".")
    )


def _download(entry: Entry) -> Path:
    import pooch  # here, because it takes long to import and most runs download nothing

    cache_dir = pooch.os_cache("nsm")
    pooch.get_logger().setLevel(logging.WARNING)
    target = Path(cache_dir) / entry.path
    if not target.is_file():
        log.info("downloading %s", entry.url)
    try:
        return Path(
            pooch.retrieve(
                entry.url,
                known_hash=f"sha256:{entry.sha256}",
                fname=target.name,
                path=target.parent,
                downloader=pooch.HTTPDownloader(timeout=TIMEOUT),
            )
        )
    except (OSError, ValueError) as error:  # requests' errors are OSErrors; pooch's checksum error a ValueError
        log.debug("download failed", exc_info=error)
        raise InputError(
            f"{entry.path} is neither under NSM_DATA_DIR nor could it be downloaded ({type(error).__name__}): fetch "
            f"{entry.url} elsewhere, put it at $NSM_DATA_DIR/{entry.path} and set NSM_DATA_DIR to that folder."
        ) from error
