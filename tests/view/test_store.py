"""The cache of the viewer: what it computes first, and what it keeps."""

from __future__ import annotations

import threading

import torch

from nsm.types import SimplexMesh
from nsm.view.pictures import Picture, Settings, Surface
from nsm.view.store import Key, Store

COARSE = Settings(resolution=16)


def picture(size: int) -> Picture:
    """A picture that takes so many bytes."""
    nothing = SimplexMesh(torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.long))
    return Picture(Surface(nothing, torch.zeros(0, 3), 0.0, 0.0, 0.0, 0), bytes(size))


def filled_store(limit: int, morphs: int = 1, times: int = 9, size: int = 10) -> Store:
    """A store in which everything is made that finds room."""
    store = Store(morphs, times, COARSE, limit)
    make_all(store, size)
    return store


def make_all(store: Store, size: int = 10) -> list[Key]:
    made = []
    while not store.complete:
        key = store.next()
        assert key is not None
        store.put(key, picture(size))
        made.append(key)
        assert len(made) < 1000, "the same pictures are made again and again"
    return made


def test_pictures_are_made_from_the_wanted_time_outwards() -> None:
    store = Store(2, 5, COARSE, 1 << 20)
    store.want(time=2)
    order = [(key.time, key.morph) for key in make_all(store)]
    assert order[:2] == [(2, 0), (2, 1)]
    distances = [abs(number - 2) for number, _ in order]
    assert distances == sorted(distances)
    assert len(set(order)) == 10


def test_a_change_of_mind_comes_first() -> None:
    store = Store(1, 9, COARSE, 1 << 20)
    store.put(store.next(), picture(10))
    store.want(time=8)
    assert store.next() == Key(0, 8, COARSE)
    other = COARSE._replace(resolution=20)
    store.want(settings=other)
    assert store.next() == Key(0, 8, other)


def test_the_nearest_picture_stands_in_for_one_that_is_not_there() -> None:
    store = Store(1, 9, COARSE, 1 << 20)
    assert store.nearest(0) is None
    for number in (0, 5):
        store.put(Key(0, number, COARSE), picture(10))
    store.want(time=4)
    assert store.nearest(0) == Key(0, 5, COARSE)
    store.want(settings=COARSE._replace(exact=True))
    assert store.nearest(0) is None


def test_memory_keeps_what_is_near_and_the_work_ends() -> None:
    store = filled_store(limit=45)
    assert sorted(key.time for key in store.ready()) == [0, 1, 2, 3]
    store.want(time=8)
    make_all(store)
    assert sorted(key.time for key in store.ready()) == [5, 6, 7, 8]
    assert store.size <= 45


def test_the_work_ends_even_where_not_one_picture_finds_room() -> None:
    store = filled_store(limit=1, morphs=2)
    assert len(store.ready()) <= 2


def test_what_is_on_show_stays() -> None:
    store = filled_store(limit=45)
    store.show({Key(0, 0, COARSE)})
    store.want(time=8)
    make_all(store)
    assert store.get(Key(0, 0, COARSE)) is not None


def test_other_settings_go_first_and_the_latest_of_them_last() -> None:
    store = Store(1, 2, COARSE, 60)
    first, second, third = (COARSE._replace(resolution=n) for n in (20, 21, 22))
    for settings in (first, second, first, third):
        store.want(settings=settings)
        make_all(store)
    store.want(settings=third._replace(exact=True))
    gone = {key.settings for number in range(2) for key in store.put(Key(0, number, store.settings), picture(10))}
    assert gone == {second}


def test_another_color_needs_no_other_surface() -> None:
    store = filled_store(limit=1 << 20)
    held = store.get(Key(0, 3, COARSE))
    assert held is not None
    assert store.surface(Key(0, 3, COARSE._replace(color="eikonal"))) is held.surface
    assert store.surface(Key(0, 3, COARSE._replace(offset=0.1))) is None


def test_a_closed_storex() -> None:
    store = filled_store(limit=1 << 20)
    waiting = threading.Thread(target=store.next)
    waiting.start()
    store.close()
    waiting.join(2)
    assert not waiting.is_alive()
