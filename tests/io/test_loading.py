"""Loading of morphs: the growth that a configuration names, and what a checkpoint says of its shapes."""

from __future__ import annotations

from pathlib import Path

import pytest
from analytic import save, sentence, shrinking
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.io.loading import build_growth, load_morphs
from nsm.morphs.growth import Grown, Growth


def configured(*overrides: str) -> dict:
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return OmegaConf.to_container(compose("evaluate", overrides=list(overrides)), resolve=True)["growth"]


@pytest.mark.parametrize("name", sorted(p.stem for p in (CONF / "growth").glob("*.yaml")))
def test_every_configured_growth_goes_between_the_shapes_own_volumes(name):
    growth = build_growth(configured(f"growth={name}"), 3, own={0.0: 1.0, 1.0: 2.5})
    if name == "none":
        assert growth is None
        return
    assert isinstance(growth, Growth)
    assert (growth.relative_volume(0.0), growth.relative_volume(1.0)) == pytest.approx((1.0, 2.5))


def test_without_a_choice_nothing_grows():
    assert build_growth(configured(), 2) is None
    assert build_growth(None, 2) is None


def test_volumes_can_be_typed():
    growth = build_growth(configured("growth=smooth_step", "growth.target=2"), 2, own={0.0: 0.7, 1.0: 0.8})
    assert (growth.relative_volume(0.0), growth.relative_volume(1.0)) == pytest.approx((0.7, 2.0))
    table = build_growth(
        configured("growth=table", "growth.times=[0,0.3,1]", "growth.volumes=[null,2,0.5]"), 2, {0.0: 3, 1.0: 1}
    )
    assert [table.relative_volume(t) for t in (0.0, 0.3, 1.0)] == pytest.approx([3, 2, 0.5])


def test_a_checkpoint_tells_the_volumes_of_its_shapes(tmp_path: Path):
    morph = shrinking(3, 0.1)
    provenance = {"source": {"scale": 1.0}, "target": {"scale": 0.5}}
    file = save(morph, tmp_path / "run" / "checkpoints" / "best.ckpt", provenance=provenance)
    known = {"checkpoint": str(file), "official": None, "growth": configured("growth=volume_linear")}
    known |= {"ends": "network"}
    (subject,) = load_morphs(known, "nsm.evaluate")
    assert isinstance(subject.morph, Grown)
    assert [subject.morph.growth.relative_volume(t) for t in (0.0, 0.5, 1.0)] == pytest.approx([1, 4.5, 8])
    (plain,) = load_morphs(known | {"growth": configured()}, "nsm.evaluate")
    assert not isinstance(plain.morph, Grown)
    save(morph, file)  # which tells no scales
    (subject,) = load_morphs(known, "nsm.evaluate")
    assert subject.morph.growth.extremes == (1, 1)


ROOM = "nsm.morphs.growth"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            {"_target_": f"{ROOM}.VolumeLinear", "source": -1.0},
            "`growth.source` must be positive and finite, got -1",
        ),
        ({"_target_": f"{ROOM}.ScaleLinear", "target": 0}, "`growth.target` must be positive and finite, got 0"),
        ({"_target_": f"{ROOM}.SmoothStep", "target": float("inf")}, "`growth.target` must be positive and finite"),
        ({"_target_": f"{ROOM}.SmoothStep", "target": "much"}, "much"),
        (
            {"_target_": f"{ROOM}.VolumeLinear", "source": True},
            "`growth.source` must be positive and finite, got True",
        ),
        (
            {"_target_": f"{ROOM}.VolumeLinear", "speed": 1.0},
            "must have the arguments of",
        ),
        ({"_target_": f"{ROOM}.Explosive"}, "must be a Growth of nsm"),
        ({"_target_": "nowhere.Growth"}, "must be a Growth of nsm"),
        ({"_target_": "builtins.dict"}, "must be a Growth of nsm that reads no other file, got 'builtins.dict'"),
        ({"_target_": f"{ROOM}.Growth"}, "must have the arguments of"),
        (
            {"_target_": f"{ROOM}.Table", "times": [0, 1], "volumes": [1]},
            "must be 2 volumes, one for each time, got [1]",
        ),
        (
            {"_target_": f"{ROOM}.Table", "times": [0, 2], "volumes": [1, 2]},
            "must be a list from 0 to 1, got [0.0, 2.0]",
        ),
        ({"_target_": f"{ROOM}.Table", "times": [0, 0.5, 0.5, 1], "volumes": [1, 2, 3, 4]}, "increasing numbers"),
        ({"_target_": f"{ROOM}.Table", "times": [], "volumes": []}, "must be a list from 0 to 1, got []"),
        ({"_target_": f"{ROOM}.Table", "times": 3, "volumes": [1]}, "3"),
        ({"_target_": f"{ROOM}.Table", "times": [0, 0.5, 1], "volumes": [1, None, 1]}, "got nothing"),
    ],
)
def test_invalid_growths_are_rejected_with_something_to_try(settings, words):
    with pytest.raises(InputError) as refused:
        build_growth(settings, 3)
    assert words in sentence(str(refused.value))
    assert "Try" in str(refused.value)
