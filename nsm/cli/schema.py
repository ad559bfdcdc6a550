"""Types and ranges of all settings in one table, which every command applies to its configuration before it begins.

The first pattern that matches the dotted name of a setting gives its check: ``*`` stands for one part of the name, and
``**`` for any number of characters. `nsm.cli.validation` applies them.
"""

from __future__ import annotations

import re
from functools import cache, partial

from nsm.cli import settings
from nsm.cli.checks import (
    MOST_THREADS,
    Check,
    any_list,
    either,
    entries,
    labels,
    names,
    optional,
    rates,
    rising,
    section,
)
from nsm.cli.settings import (
    at_least,
    between,
    choice,
    morph_time,
    morph_times,
    number,
    numbers,
    positive,
    switch,
    text,
    whole_number,
)
from nsm.cli.training_schema import TRAINING

#: Most cells along the box, and pixels along a picture.
_MOST_CELLS, _MOST_PIXELS = 4096, 16384
#: Most steps, and most points that a measurement draws.
_MOST_STEPS, _MOST_SAMPLES = 10**9, 10**7


_steps = partial(whole_number, most=_MOST_STEPS, example=1000)
_cells = partial(whole_number, least=2, most=_MOST_CELLS, example=96)
_pixels = partial(whole_number, least=16, most=_MOST_PIXELS, example=400)
_times = partial(whole_number, least=2, most=100_000, example=11)
_ends = partial(choice, known=("exact", "network"))
_seconds = partial(between, low=0, high=86400, example=4.0)

#: Checks of the settings that commands on finished morphs share.
_MORPHS: dict[str, Check] = {
    "checkpoint": optional(names),
    "official": optional(names),
    "ends": _ends,
    "output": optional(text),
    "timing": optional(section),
    "timing.power": partial(at_least, least=1.0, example=2.0),
    "timing.pairs": any_list,
    "growth": optional(section),
    "growth.source": optional(positive),
    "growth.target": optional(positive),
    "growth.times": optional(rising),
    "growth.volumes": entries,
    "resolution": partial(whole_number, least=8, most=_MOST_CELLS, example=96),
    "volume_resolution": partial(whole_number, least=8, most=_MOST_CELLS, example=96),
    "surface_resolution": partial(whole_number, least=8, most=_MOST_CELLS, example=128),
    "samples": partial(whole_number, most=_MOST_SAMPLES, example=10_000),
    "picture_size": _pixels,
    "exact_volume": switch,
    "seconds": _seconds,
    "offset": number,
    "slices": section,
    "slices.times": morph_times,
    "slices.offset": number,
    "axis": partial(choice, known=("x", "y", "z")),
    "slices.axis": partial(choice, known=("x", "y", "z")),
}
#: Checks of the settings of each command; the first pattern that matches counts.
_RULES: dict[str, dict[str, Check]] = {
    "train": TRAINING,
    "evaluate": {**_MORPHS, "times": _times, "shell_width": positive},
    "export": {
        **_MORPHS,
        "times": morph_times,
        "resolution": optional(_cells),
        "format": optional(text),
        "coordinates": optional(partial(choice, known=("morph", "source", "target"))),
        "labels": optional(text),
        "advect": optional(switch),
        "mesh": optional(text),
        "project": switch,
    },
    "render": {
        **_MORPHS,
        "times": morph_times,
        "time": morph_time,
        "kind": partial(choice, known=("strip", "film", "turntable", "slices")),
        "color": text,
        "view": partial(numbers, lengths=(3,), example="[0.55,0.45,1]"),
        "up": partial(numbers, lengths=(3,), example="[0,1,0]"),
        "zoom": partial(between, low=0, high=1e3, example=1.0),
        "size": either(partial(whole_number, most=_MOST_PIXELS), partial(numbers, lengths=(2,), example="[1920,1080]")),
        "hold": partial(at_least, least=0, example=0.5),
        "back": switch,
        "turns": number,
        "fps": partial(whole_number, most=1000, example=30),
    },
    "view": {
        **_MORPHS,
        "times": _times,
        "level": number,
        "color": text,
        "memory": partial(whole_number, most=10**7, example=1024),
        "host": text,
        "port": optional(partial(whole_number, most=65535, example=8080)),
        "open_browser": switch,
        "record": optional(text),
        "runs": text,
        "train": any_list,
        "upload": partial(whole_number, most=10**6, example=256),
    },
    "layers": {
        "inner": optional(text),
        "outer": optional(text),
        "inner_label": optional(labels),
        "outer_label": optional(labels),
        "layers": either(partial(whole_number, most=1000, example=4), numbers),
        "resolution": partial(whole_number, least=8, most=_MOST_CELLS, example=128),
        "format": optional(text),
        "output": optional(text),
    },
    "compare": {
        **_MORPHS,
        "name": text,
        "times": _times,
        "seeds": entries,
        "minutes": optional(partial(settings.up_to, most=1e6, example=8.0)),
        "steps": optional(_steps),
        "overrides": any_list,
        "pairs": any_list,
        "methods": any_list,
        "official": switch,
        "retry": switch,
        "strip_times": morph_times,
        "learning_rates": optional(rates),
        "slices.changes": partial(whole_number, least=0, most=1000),
        "paper": section,
    },
}
#: Checks of settings of all commands.
_COMMON: dict[str, Check] = {
    "threads": optional(partial(whole_number, most=MOST_THREADS)),
    "**_target_": optional(text),
    "**_partial_": switch,
}


@cache
def check_of(name: str, command: str) -> Check | None:
    """The check of a setting of a command; None if no pattern matches its dotted name."""
    rules = {**_COMMON, **_RULES.get(command, {})}
    return next((check for pattern, check in rules.items() if _expression(pattern).fullmatch(name)), None)


@cache
def _expression(pattern: str) -> re.Pattern[str]:
    parts = {"**": ".*", "*": "[^.]+"}
    return re.compile("".join(parts.get(part, re.escape(part)) for part in re.split(r"(\*\*|\*)", pattern)))
