"""Public data by name: found under NSM_DATA_DIR or downloaded once, and verified by checksum."""

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

from nsm.cli.cache import cache_folder, require_writable_cache, writing_to_cache
from nsm.cli.errors import InputError
from nsm.cli.files import DISK_ERRORS, atomic_write

log = logging.getLogger(__name__)

#: Timeout of a download, in seconds.
TIMEOUT = 10


class Entry(NamedTuple):
    """A file of the manifest.

    Attributes:
        path: Name of the file, and its path relative to NSM_DATA_DIR.
        bytes: Size in bytes.
        sha256: SHA-256 checksum in hexadecimal.
        url: Address from which the file is downloaded.
    """

    path: str
    bytes: int
    sha256: str
    url: str


@cache
def manifest() -> dict[str, Entry]:
    """Read the public files by name from ``manifest.tsv`` beside this module."""
    with files("nsm.shapes").joinpath("manifest.tsv").open(encoding="utf-8") as lines:
        rows = csv.DictReader(lines, delimiter="\t")
        return {row["path"]: Entry(row["path"], int(row["bytes"]), row["sha256"], row["url"]) for row in rows}


def file_sha256(path: Path) -> str:
    """Compute the SHA-256 checksum of a file in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def fetch(name: str) -> Path:
    """Find or download a file of the manifest, and verify its checksum.

    Args:
        name: Path in the manifest, such as ``official/ni/kitten.pth``.

    Returns:
        Path of the local copy.

    Raises:
        InputError: If the name is unknown, the checksum differs, or there is neither a copy nor a network.
    """
    entry = manifest().get(name)
    if entry is None:
        near = get_close_matches(name, manifest(), n=3)
        hint = " or ".join(f"`{match}`" for match in near) if near else "a name in `nsm/shapes/manifest.tsv`"
        raise InputError(f"`path` must be the name of a public file, got {name}. Try {hint}.")
    root = os.environ.get("NSM_DATA_DIR")
    if root and (local := Path(root).expanduser() / entry.path).is_file():
        if (found := file_sha256(local)) != entry.sha256:
            raise InputError(
                f"`{local}` must have the SHA-256 checksum {entry.sha256[:12]}…, got {found[:12]}…. Try to replace it "
                f"by {entry.url}, or delete it so that it is downloaded."
            )
        return local
    return _download(entry)


def resolve(path: str | os.PathLike[str]) -> Path:
    """Find a local file of that path, or else the public file of that name.

    Raises:
        InputError: If there is neither, or the path is a folder.
    """
    local = Path(path).expanduser()
    if local.is_file():
        return local
    if local.is_dir():
        raise InputError(f"`path` must be a file, got the folder {local}. Try the path of a file in it.")
    if str(path) in manifest():
        return fetch(str(path))
    example = next(iter(get_close_matches(str(path), manifest(), n=1)), "meshes/spot.obj")
    raise InputError(f"`path` must be an existing file or a public name, got {local}. Try `{example}`.")


def _download(entry: Entry) -> Path:
    target = cache_folder() / entry.path
    if target.is_file():
        if file_sha256(target) == entry.sha256:
            return target
        log.warning("The cached %s is damaged and is downloaded again.", target)
    require_writable_cache()
    log.info("downloading %s", entry.url)
    with writing_to_cache(), atomic_write(target) as temporary:
        _retrieve(entry, temporary)
    return target


def _retrieve(entry: Entry, path: Path) -> None:
    """Download a file and verify its checksum."""
    import pooch  # imported here because it is slow to import and rarely needed

    pooch.get_logger().setLevel(logging.WARNING)
    path.unlink()
    try:
        pooch.retrieve(
            entry.url,
            known_hash=f"sha256:{entry.sha256}",
            fname=path.name,
            path=path.parent,
            downloader=pooch.HTTPDownloader(timeout=TIMEOUT),
        )
    # errors of requests are OSErrors, and the checksum error of pooch is a ValueError
    except (OSError, ValueError) as error:
        if isinstance(error, OSError) and error.errno in DISK_ERRORS:
            raise
        log.debug("download failed", exc_info=error)
        raise InputError(
            f"`{entry.path}` must be under NSM_DATA_DIR or downloadable, got {type(error).__name__} on download. Try "
            f"to download {entry.url} elsewhere, and save it as $NSM_DATA_DIR/{entry.path}."
        ) from None
