"""The operator cache: what is found again is what was computed, whatever happened to the folder."""

from __future__ import annotations

import logging
import os
import pickle
import subprocess
import sys
import time
import warnings
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from homolog.core.errors import ArgumentError
from homolog.core.files import atomic_path
from homolog.geometry import OperatorCache, Operators, OperatorSettings, cache, cache_folder
from homolog.shapes import Shape

SETTINGS = OperatorSettings(n_eigenpairs=12)


@pytest.fixture(scope="module")
def shape(make) -> Shape:
    return make.blob(2)


@pytest.fixture
def computed(monkeypatch) -> list[Shape]:
    """The shapes that operators were computed of, in order."""
    calls = []
    compute = cache.compute_operators

    def counted(shape, **options):
        calls.append(shape)
        return compute(shape, **options)

    monkeypatch.setattr(cache, "compute_operators", counted)
    return calls


def assert_same(first: Operators, second: Operators) -> None:
    """Equal bit for bit."""
    for name in (f.name for f in fields(Operators)):
        one, other = getattr(first, name), getattr(second, name)
        if not isinstance(one, torch.Tensor):
            assert one == other, name
        elif one.layout == torch.sparse_csr:
            for part in ("crow_indices", "col_indices", "values"):
                assert getattr(one, part)().dtype == getattr(other, part)().dtype
                assert torch.equal(getattr(one, part)(), getattr(other, part)()), name
        else:
            assert one.dtype == other.dtype and torch.equal(one, other), name


def entry_of(folder: Path) -> Path:
    (entry,) = folder.rglob("*.safetensors")
    return entry


@pytest.mark.parametrize("modality", ["mesh", "cloud"])
def test_a_hit_equals_what_was_computed_bit_for_bit(modality: str, shape, tmp_path, computed) -> None:
    given = shape.as_cloud() if modality == "cloud" else shape
    store = OperatorCache(tmp_path / "made" / "on use")
    first = store.operators(given, settings=SETTINGS)
    second = store.operators(given, settings=SETTINGS)
    assert len(computed) == 1
    assert_same(first, second)
    values = torch.ones(given.n_points, 1)
    assert torch.equal(first.gradient_x @ values, second.gradient_x @ values)
    count, size = store.size()
    assert count == 1 and size == entry_of(store.folder).stat().st_size


def test_whatever_changes_the_operators_makes_another_entry(shape, tmp_path, computed) -> None:
    store = OperatorCache(tmp_path)
    nudged = shape.points.copy()
    nudged[3, 1] += 1e-12
    asked = [
        (shape, SETTINGS, None),
        (shape, SETTINGS, 2.0),
        (shape, OperatorSettings(n_eigenpairs=13), None),
        (shape, OperatorSettings(n_eigenpairs=12, laplacian="cotangent"), None),
        (shape.as_cloud(), SETTINGS, None),
        (shape.as_cloud(), OperatorSettings(n_eigenpairs=12, n_neighbours=20), None),
        (Shape(nudged, shape.faces), SETTINGS, None),
        (Shape(shape.points, shape.faces[:, ::-1]), SETTINGS, None),
    ]
    for _ in range(2):
        for given, settings, scale in asked:
            store.operators(given, settings=settings, scale=scale)
    assert len(computed) == len(asked) == store.size()[0]


def test_the_name_of_a_shape_is_not_part_of_it(shape, tmp_path, computed) -> None:
    store = OperatorCache(tmp_path)
    store.operators(shape, settings=SETTINGS)
    store.operators(Shape(shape.points, shape.faces, name="other.ply"), settings=SETTINGS)
    assert len(computed) == 1


def test_half_precision_keeps_all_but_the_last_digits_of_the_eigenvectors(shape, tmp_path, computed) -> None:
    full, half = OperatorCache(tmp_path), OperatorCache(tmp_path, eigenvectors="float16")
    exact = full.operators(shape, settings=SETTINGS)
    first = half.operators(shape, settings=SETTINGS)
    again = half.operators(shape, settings=SETTINGS)
    assert len(computed) == 2 and half.size()[0] == 2
    assert again.eigenvectors.dtype == torch.float32
    assert torch.equal(first.eigenvectors, again.eigenvectors)
    torch.testing.assert_close(again.eigenvectors, exact.eigenvectors, rtol=5e-4, atol=1e-6)
    assert not torch.equal(again.eigenvectors, exact.eigenvectors)
    assert torch.equal(again.eigenvalues, exact.eigenvalues)
    large, small = sorted((path.stat().st_size for path in tmp_path.rglob("*.safetensors")), reverse=True)
    assert large - small == pytest.approx(2 * 12 * shape.n_points, abs=100)


def foreign(path: Path) -> None:
    save_file({"points": torch.zeros(3, 3), "odd": torch.zeros(2, dtype=torch.bfloat16)}, path)


def emptied(path: Path) -> None:
    path.write_bytes(b"")


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def garbage(path: Path) -> None:
    path.write_bytes(np.random.default_rng(0).bytes(5000))


def another_shapes(path: Path) -> None:
    points = np.random.default_rng(1).normal(size=(30, 3))
    OperatorCache(path.parent / "others").operators(Shape(points), settings=SETTINGS)
    (other,) = (path.parent / "others").rglob("*.safetensors")
    other.replace(path)


def without_notes(path: Path) -> None:
    from safetensors.torch import load_file

    save_file(load_file(path), path)


class Bomb:
    """Leaves a trace when it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self):
        return (Path.touch, (self.trace,))


def a_pickle(path: Path) -> None:
    path.write_bytes(pickle.dumps(Bomb(path.parent / "trace")))


def a_torch_pickle(path: Path) -> None:
    torch.save(Bomb(path.parent / "trace"), path)


DAMAGES = [foreign, emptied, truncated, garbage, another_shapes, without_notes, a_pickle, a_torch_pickle]


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_entry_is_computed_anew_and_replaced(damage, shape, tmp_path, computed, caplog) -> None:
    store = OperatorCache(tmp_path)
    first = store.operators(shape, settings=SETTINGS)
    damage(entry_of(tmp_path))
    with caplog.at_level(logging.WARNING):
        second = store.operators(shape, settings=SETTINGS)
    assert "damaged" in caplog.text
    assert_same(first, second)
    n_computed = len(computed)
    assert_same(first, store.operators(shape, settings=SETTINGS))
    assert len(computed) == n_computed
    assert not (tmp_path / "trace").exists()


def test_a_flipped_bit_anywhere_is_noticed(shape, tmp_path) -> None:
    store = OperatorCache(tmp_path)
    first = store.operators(shape, settings=SETTINGS)
    entry = entry_of(tmp_path)
    whole = entry.read_bytes()
    header = 8 + int.from_bytes(whole[:8], "little")
    rng = np.random.default_rng(1)
    places = [*range(0, header, 3), *rng.integers(header, len(whole), 60)]
    unnoticed = []
    for place in places:
        flipped = bytearray(whole)
        flipped[place] ^= 1 << int(rng.integers(8))
        entry.write_bytes(flipped)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = cache._read(entry)
        if found is not None:
            unnoticed.append(place)
            assert_same(first, found)  # at most the padding of the header may change
    assert len(unnoticed) <= 3


def test_the_length_in_an_entry_is_checked_too(shape, tmp_path, computed) -> None:
    store = OperatorCache(tmp_path)
    first = store.operators(shape, settings=SETTINGS)
    entry = entry_of(tmp_path)
    written = first.scale.hex().encode()
    other = written.replace(b"0x1.", b"0x1.0", 1)[: len(written) - 4] + written[-4:]
    assert len(other) == len(written)
    assert entry.read_bytes().count(written) == 1
    entry.write_bytes(entry.read_bytes().replace(written, other))
    assert_same(first, store.operators(shape, settings=SETTINGS))
    assert len(computed) == 2


def test_the_least_recently_used_entries_make_room(make, tmp_path, computed) -> None:
    # Radii differ, so that the shapes do; sizes of the entries do not.
    shapes = [make.sphere(1, radius=1 + i) for i in range(4)]
    store = OperatorCache(tmp_path)
    store.operators(shapes[0], settings=SETTINGS)
    entry_size = store.size()[1]
    bounded = OperatorCache(tmp_path, max_bytes=int(3.5 * entry_size))
    for i, shape in enumerate(shapes[:3]):
        bounded.operators(shape, settings=SETTINGS)
        newest = max(tmp_path.rglob("*.safetensors"), key=lambda path: path.stat().st_mtime_ns)
        os.utime(newest, (1000 + i, 1000 + i))
    bounded.operators(shapes[0], settings=SETTINGS)  # a hit makes the oldest the newest
    assert len(computed) == 3
    bounded.operators(shapes[3], settings=SETTINGS)
    assert bounded.size()[0] == 3 and bounded.size()[1] <= bounded.max_bytes
    computed.clear()
    for shape in (shapes[0], shapes[2], shapes[3]):
        bounded.operators(shape, settings=SETTINGS)
    assert not computed
    bounded.operators(shapes[1], settings=SETTINGS)
    assert computed == [shapes[1]]


def test_a_bound_smaller_than_one_entry_keeps_none_and_still_answers(shape, tmp_path) -> None:
    store = OperatorCache(tmp_path, max_bytes=10)
    assert store.operators(shape, settings=SETTINGS).n_points == shape.n_points
    assert store.size() == (0, 0)


def test_a_folder_that_cannot_be_written_costs_a_warning_alone(shape, tmp_path, caplog) -> None:
    blocked = tmp_path / "a file"
    blocked.write_text("in the way")
    store = OperatorCache(blocked / "cache")
    with caplog.at_level(logging.WARNING):
        found = store.operators(shape, settings=SETTINGS)
    assert found.n_points == shape.n_points
    assert "not cached" in caplog.text
    assert store.size() == (0, 0)


def test_a_folder_that_cannot_be_looked_into_costs_a_warning_alone(shape, tmp_path, monkeypatch, caplog) -> None:
    def forbidden(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    for looking in ("mkdir", "is_dir"):
        monkeypatch.setattr(Path, looking, forbidden)
    assert OperatorCache(tmp_path / "cache").operators(shape, settings=SETTINGS).n_points == shape.n_points
    assert "not cached" in caplog.text


def test_a_write_that_fails_half_way_leaves_nothing_behind(shape, tmp_path, monkeypatch, caplog) -> None:
    def full_disk(tensors, path, metadata):
        Path(path).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cache, "save_file", full_disk)
    found = OperatorCache(tmp_path).operators(shape, settings=SETTINGS)
    assert found.n_points == shape.n_points and "No space left" in caplog.text
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_what_another_process_is_writing_is_no_entry(make, tmp_path) -> None:
    store = OperatorCache(tmp_path, max_bytes=1)  # every entry must go
    with atomic_path(tmp_path / "half.safetensors") as temporary:
        temporary.write_bytes(b"half" * 1000)
        os.utime(temporary, (time.time() - 3600,) * 2)  # older than what comes next
        assert store.size() == (0, 0)
        store.operators(make.sphere(1), settings=SETTINGS)
        assert temporary.exists()
    assert (tmp_path / "half.safetensors").read_bytes() == b"half" * 1000


def test_what_a_killed_process_left_goes_after_a_day(make, tmp_path) -> None:
    names = {".0123456789ab.safetensors": 25, ".ba9876543210.safetensors": 1}
    for name, hours in names.items():
        (tmp_path / name).write_bytes(b"half")
        os.utime(tmp_path / name, (time.time() - 3600 * hours,) * 2)
    store = OperatorCache(tmp_path)
    store.operators(make.sphere(1), settings=SETTINGS)
    assert store.size()[0] == 1
    assert [path.name for path in tmp_path.glob(".*")] == [".ba9876543210.safetensors"]


def test_the_environment_chooses_folder_and_bound(monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("HOMOLOG_CACHE", str(tmp_path / "here"))
    monkeypatch.setenv("HOMOLOG_CACHE_GB", "0.5")
    store = OperatorCache.default()
    assert (store.folder, store.max_bytes) == (tmp_path / "here", 2**29)
    monkeypatch.delenv("HOMOLOG_CACHE_GB")
    assert OperatorCache.default().max_bytes == 10 * 2**30
    monkeypatch.setenv("HOMOLOG_CACHE", "~/somewhere")
    assert cache_folder() == Path.home() / "somewhere"
    monkeypatch.delenv("HOMOLOG_CACHE")
    assert "homolog" in str(cache_folder())


@pytest.mark.parametrize("value", ["ten", "", "nan", "inf", "1e400"])
def test_a_bound_that_is_no_number_is_refused(value: str, monkeypatch) -> None:
    monkeypatch.setenv("HOMOLOG_CACHE_GB", value)
    with pytest.raises(ArgumentError, match="HOMOLOG_CACHE_GB"):
        OperatorCache.default()


WORKER = """
import sys, time, trimesh, numpy as np
from pathlib import Path
from homolog.geometry import OperatorCache, OperatorSettings
from homolog.shapes import Shape
folder, ready = Path(sys.argv[1]), Path(sys.argv[2])
mesh = trimesh.creation.icosphere(subdivisions=2)
shape = Shape(mesh.vertices, mesh.faces)
(ready / sys.argv[3]).touch()
while len(list(ready.iterdir())) < 3:
    time.sleep(0.005)
for round in range(15):
    found = OperatorCache(folder).operators(shape, settings=OperatorSettings(n_eigenpairs=12))
    print(float(found.eigenvectors.double().abs().sum()).hex())
    if round < 10:  # so that the entry is written and read over and over
        for path in folder.glob("[!.]*.safetensors"):
            path.unlink(missing_ok=True)
"""


@pytest.mark.process
def test_several_processes_may_write_the_same_entry_at_once(tmp_path) -> None:
    ready = tmp_path / "ready"
    ready.mkdir()
    command = [sys.executable, "-c", WORKER, str(tmp_path / "cache"), str(ready)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    single = {**os.environ, "OMP_NUM_THREADS": "1"}
    workers = [subprocess.Popen([*command, str(i)], env=single, **pipes) for i in range(3)]
    results = [worker.communicate(timeout=300) for worker in workers]
    assert [worker.returncode for worker in workers] == [0, 0, 0], results
    assert len({line for printed, _ in results for line in printed.split()}) == 1
    assert all("damaged" not in messages for _, messages in results), results
    assert len(list((tmp_path / "cache").iterdir())) == 1


def test_entries_lie_in_folders_by_their_first_digits(shape, tmp_path) -> None:
    store = OperatorCache(tmp_path)
    for n_eigenpairs in (4, 5, 6):
        store.operators(shape, settings=OperatorSettings(n_eigenpairs=n_eigenpairs))
    found = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert len(found) == 3 == store.size()[0]
    assert all(path == store.entry(path.stem) and path.parent == tmp_path / path.stem[:2] for path in found)


def test_entries_of_earlier_versions_count_and_go_first(shape, tmp_path) -> None:
    for number in range(2):
        (tmp_path / f"{number}.safetensors").write_bytes(bytes(10**6))
        os.utime(tmp_path / f"{number}.safetensors", (number, number))
    OperatorCache(tmp_path, max_bytes=1_500_000).operators(shape, settings=SETTINGS)
    assert [path.name for path in tmp_path.glob("*.safetensors")] == ["1.safetensors"]


def test_a_folder_is_listed_once_in_a_hundredth_of_its_bound(shape, tmp_path, calls) -> None:
    seen = calls(OperatorCache, "make_room")
    store = OperatorCache(tmp_path / "cache")
    entry = 0
    for n_eigenpairs in range(4, 10):
        store.operators(shape, settings=OperatorSettings(n_eigenpairs=n_eigenpairs))
        entry = entry or store.size()[1]
    assert len(seen) == 1  # by the first entry of this process
    bounded = OperatorCache(tmp_path / "cache", max_bytes=150 * entry)  # of which every second entry is a hundredth
    for n_eigenpairs in range(10, 14):
        bounded.operators(shape, settings=OperatorSettings(n_eigenpairs=n_eigenpairs))
    assert 2 <= len(seen) <= 4
