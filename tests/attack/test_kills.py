"""A command that is killed at any moment leaves whole files, and repeating it gives what it would have given."""

from __future__ import annotations

import random
import signal
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from nightly import NIGHTLY, tries
from table import Tally
from victims import VICTIMS, Outcome, Victim, files, prepare, require_whole, run

#: Kills of each command: half of them before a change of a file, half at any time.
KILLS = tries(3, 20)
#: Gives how a command ends that nobody kills, and its files.
Undisturbed = Callable[[Victim], tuple[Outcome, set[str]]]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    """How a command ends that nobody kills, and its files."""

    @cache
    def through(victim: Victim) -> tuple[Outcome, set[str]]:
        place = tmp_path_factory.mktemp("undisturbed")
        if victim.name in ("train", "compare"):
            run(victim, place / "first", place)  # the second one finds its networks in the cache, as those attacked do
        prepare(victim, place / "folder")
        outcome = run(victim, place / "folder", place)
        assert outcome.status == 0, outcome.said
        require_whole(place / "folder")
        return outcome, files(place / "folder")

    return through


@pytest.mark.parametrize("number", range(KILLS))
@pytest.mark.parametrize("victim", [v for v in VICTIMS if NIGHTLY or not v.nightly], ids=str)
def test_a_killed_command_leaves_whole_files_and_finishes_when_repeated(
    victim: Victim, number: int, undisturbed: Undisturbed, tmp_path: Path, tally: Tally
) -> None:
    reference, wanted = undisturbed(victim)
    chance = random.Random(f"{victim} {number}")
    folder = tmp_path / "folder"
    prepare(victim, folder)
    with tally.attack(f"`{victim}` killed, then repeated"):
        if number % 2:
            killed = run(victim, folder, tmp_path, kill_after=chance.uniform(0.01, reference.seconds))
        else:
            killed = run(victim, folder, tmp_path, kill_before=chance.randint(1, reference.changes))
        assert killed.status in (-signal.SIGKILL, -signal.SIGALRM, 0), killed.said
        require_whole(folder)
        repeated = run(victim, folder, tmp_path)
        assert repeated.status == 0, repeated.said
        require_whole(folder)
        assert files(folder) == wanted
