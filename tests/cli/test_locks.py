"""One process at a time writes, and what a killed one left behind is removed by the next."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.cli.locks import only_writer_of_file, only_writer_of_folder, scratch_folder

_WRITE = """
import sys, time
from pathlib import Path
from nsm.cli.files import atomic_write
from nsm.cli.locks import only_writer_of_file, only_writer_of_folder
file = Path(sys.argv[1])
with only_writer_of_folder(file.parent), only_writer_of_file(file), atomic_write(file) as temporary:
    temporary.write_text("half")
    print("writing", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def writer(tmp_path: Path):
    """Another process in the middle of writing ``folder/file.txt``."""
    command = [sys.executable, "-c", _WRITE, str(tmp_path / "folder" / "file.txt")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "writing\n"
        yield process
        process.kill()


def test_a_second_writer_is_refused_in_a_sentence_until_the_first_has_ended(
    writer: subprocess.Popen[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nsm.cli.locks._PATIENCE", 0.1)
    file = tmp_path / "folder" / "file.txt"
    with pytest.raises(InputError, match="one command at a time, got a second"), only_writer_of_folder(file.parent):
        pass
    with pytest.raises(InputError, match="one command at a time, got a second"), only_writer_of_file(file):
        pass
    writer.send_signal(signal.SIGKILL)
    writer.wait()
    with only_writer_of_folder(file.parent), only_writer_of_file(file):
        pass
    assert not list(file.parent.iterdir())


def test_what_a_living_process_writes_is_left_alone_and_what_a_killed_one_left_is_removed(
    writer: subprocess.Popen[str], tmp_path: Path
) -> None:
    file = tmp_path / "folder" / "file.txt"
    before = sorted(file.parent.rglob("*"))
    with atomic_write(file.with_name("other.txt")) as temporary:
        temporary.write_text("whole")
    assert sorted(file.parent.rglob("*")) == sorted([*before, file.with_name("other.txt")])
    writer.send_signal(signal.SIGKILL)
    writer.wait()
    assert sorted(file.parent.rglob("*")) == sorted([*before, file.with_name("other.txt")])
    with atomic_write(file) as temporary:
        temporary.write_text("whole")
    assert sorted(path.name for path in file.parent.iterdir()) == ["file.txt", "other.txt"]


def test_a_lock_of_a_folder_removes_what_killed_commands_left_in_its_folders(tmp_path: Path) -> None:
    (tmp_path / "a" / ".nsm-0123" / "b").mkdir(parents=True)
    (tmp_path / "a" / ".nsm-0123" / "b" / "half").write_text("")
    (tmp_path / "a" / ".nsm-file.lock").write_text("")
    (tmp_path / "a" / "kept").write_text("")
    with only_writer_of_folder(tmp_path):
        assert [path.name for path in (tmp_path / "a").iterdir()] == ["kept"]


def test_a_folder_into_which_nothing_was_written_does_not_stay(tmp_path: Path) -> None:
    with pytest.raises(InputError), only_writer_of_file(tmp_path / "folder" / "file.txt"):
        raise InputError("a refusal")
    with only_writer_of_folder(tmp_path / "folder"):
        pass
    assert not list(tmp_path.iterdir())


def test_many_writers_of_one_file_each_write_it_whole(tmp_path: Path) -> None:
    file, texts = tmp_path / "file.txt", [letter * 5000 for letter in "abcdefgh"]

    def write(text: str) -> None:
        for _ in range(10):
            with atomic_write(file) as temporary:
                temporary.write_text(text)

    threads = [threading.Thread(target=write, args=(text,)) for text in texts]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        if file.is_file():
            assert file.read_text() in texts
    assert [path.name for path in tmp_path.iterdir()] == ["file.txt"]


def test_a_folder_that_cannot_be_made_is_an_error_and_no_endless_loop() -> None:
    with pytest.raises(FileNotFoundError), scratch_folder(Path("/proc/self")):
        pass


@pytest.mark.skipif(not hasattr(os, "pwrite"), reason="needs limits of file sizes")
def test_a_file_that_is_too_large_for_its_disk_is_a_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        too_large = pytest.raises(InputError, match="must fit on its disk, got: File too large")
        with too_large, atomic_write(tmp_path / "file.txt") as temporary:
            temporary.write_bytes(bytes(2000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())
