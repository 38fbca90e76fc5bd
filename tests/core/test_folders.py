"""Output folders that are filled step by step, after a process that was killed at their beginning."""

import pytest

from homolog.core.errors import ArgumentError
from homolog.core.folders import prepare_folder

MANIFEST = {"making": {"seed": 1}}


@pytest.mark.parametrize("left", [[], ["off"], ["off", "corres"]])
def test_folders_alone_are_gone_on_with(tmp_path, left):
    for name in left:
        (tmp_path / name).mkdir()
    prepare_folder(tmp_path, MANIFEST, ["off", "corres"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["corres", "manifest.json", "off"]


@pytest.mark.parametrize("theirs", ["notes.txt", "off/a.off", ".hidden", "other/"])
def test_anything_else_is_somebodys(tmp_path, theirs):
    path = tmp_path / theirs
    path.parent.mkdir(exist_ok=True)
    path.mkdir() if theirs.endswith("/") else path.touch()
    with pytest.raises(ArgumentError, match="holds other things"):
        prepare_folder(tmp_path, MANIFEST, ["off"])
    assert path.exists() and not (tmp_path / "manifest.json").exists()


@pytest.mark.parametrize("content", ["{", "[1]", '{"making": 3}', "[" * 100_000])
def test_a_damaged_manifest_is_no_manifest(tmp_path, content):
    (tmp_path / "manifest.json").write_text(content)
    with pytest.raises(ArgumentError, match="holds other things"):
        prepare_folder(tmp_path, MANIFEST, ["off"])
