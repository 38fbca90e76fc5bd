"""Settings: what is given arrives in the annotated types, and every mistake is one line that says what is allowed."""

import copy
import pickle
import subprocess
import sys
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest

from homolog.core.errors import ArgumentError
from homolog.core.settings import Count, Positive, Settings, Share, described, read_settings, read_toml


@dataclass(frozen=True)
class Plain:
    """Of another kind, with checks of its own."""

    size: int = 3

    def __post_init__(self):
        if self.size < 1:
            raise ArgumentError(f"size is {self.size}, but must be positive")


@dataclass(frozen=True, kw_only=True)
class Inner(Settings):
    rate: Positive = 1.0
    noise: tuple[Positive, ...] = ()
    betas: tuple[Share, Share] = (0.1, 0.2)
    word: Literal["cosine", "constant"] = "cosine"
    number: Annotated[Count, "not 5"] | None = None
    on: bool = False

    def check(self):
        if self.number == 5:
            raise ArgumentError("number is 5, but must not be")


@dataclass(frozen=True, kw_only=True)
class Outer(Settings):
    name: str = "x"
    inner: Inner = field(default_factory=Inner)
    plain: Plain = field(default_factory=Plain)
    more: Inner | None = None


def test_values_arrive_in_the_annotated_types():
    table = {"inner": {"rate": 2, "noise": [1, 0.5]}, "plain": {"size": 4}, "more": {}}
    found = read_settings(Outer, table, "file:")
    assert found == Outer(inner=Inner(rate=2.0, noise=(1.0, 0.5)), plain=Plain(4), more=Inner())
    assert type(found.inner.rate) is type(found.inner.noise[0]) is float
    assert read_settings(Outer, {}, "file:") == Outer() and Outer().more is None
    assert type(Inner(rate=3, noise=[1]).noise[0]) is float
    assert asdict(found)["inner"]["noise"] == (1.0, 0.5)
    assert replace(Inner(), number=2).number == 2


def test_a_word_that_is_no_field_is_named_with_the_nearest_one():
    for call, said in (
        (lambda: Inner(rat=1), "Inner has an unknown key 'rat'; did you mean 'rate'?"),
        (lambda: replace(Inner(), nois=()), "Inner has an unknown key 'nois'; did you mean 'noise'?"),
        (lambda: Outer(zzz=1), "Outer has an unknown key 'zzz'; it knows name, inner, plain, more"),
    ):
        with pytest.raises(ArgumentError) as error:
            call()
        assert str(error.value) == said
    for copied in (pickle.loads(pickle.dumps(Outer(name="y"))), copy.deepcopy(Outer(name="y"))):
        assert copied == Outer(name="y")


def test_arrays_and_paths_arrive_as_lists_and_texts():
    found = Outer(name=Path("a") / "b", inner=Inner(noise=np.array([1, 0.5]), number=np.int64(3)))
    assert found == Outer(name=str(Path("a/b")), inner=Inner(noise=(1.0, 0.5), number=3))
    with pytest.raises(ArgumentError, match=r"rate is \[1.0, 2.0\], but must be a number above 0"):
        Inner(rate=np.array([1.0, 2.0]))


def test_tuples_of_several_kinds_are_described_part_by_part():
    assert described(tuple[Count, str]) == "a list of 2: a whole number of at least 1, a text in quotes"


MISTAKES = {
    "rte": ({"inner": {"rte": 1}}, "f: [inner] has an unknown key 'rte'; did you mean 'rate'?"),
    "zzz": ({"plain": {"zzz": 1}}, "f: [plain] has an unknown key 'zzz'; it knows size"),
    "bool": ({"inner": {"rate": True}}, "f: [inner] rate is True, but must be a number above 0"),
    "nan": ({"inner": {"rate": float("nan")}}, "f: [inner] rate is nan, but must be a number above 0"),
    "inf": ({"inner": {"rate": float("inf")}}, "f: [inner] rate is inf, but must be a number above 0"),
    "text": ({"inner": {"number": "5"}}, "f: [inner] number is '5', but must be a whole number of at least 1, not 5"),
    "low": ({"inner": {"number": 0}}, "f: [inner] number is 0, but must be a whole number of at least 1, not 5"),
    "half": ({"inner": {"number": 1.5}}, "f: [inner] number is 1.5, but must be a whole number of at least 1, not 5"),
    "rule": ({"inner": {"number": 5}}, "f: [inner] number is 5, but must not be"),
    "one": ({"inner": {"noise": 1}}, "f: [inner] noise is 1, but must be a list, each of them a number above 0"),
    "item": ({"inner": {"noise": [1, "x"]}}, "f: [inner] noise holds 'x', but must be a list, each of them"),
    "short": ({"inner": {"betas": [0.5]}}, "f: [inner] betas is [0.5], but must be a list of 2, each of them a number"),
    "long": ({"inner": {"betas": [0.5] * 3}}, "f: [inner] betas is [0.5, 0.5, 0.5], but must be a list of 2"),
    "high": ({"inner": {"betas": [0.5, 1.0]}}, "f: [inner] betas holds 1.0, but must be a list of 2, each of them a"),
    "word": ({"inner": {"word": "cosin"}}, "word is 'cosin', but must be one of cosine, constant; did you mean 'co"),
    "wrong": ({"inner": {"word": 3}}, "f: [inner] word is 3, but must be one of 'cosine', 'constant'"),
    "yes": ({"inner": {"on": 1}}, "f: [inner] on is 1, but must be true or false"),
    "section": ({"inner": 3}, "f: inner is 3, but must be a section [inner]"),
    "absent": ({"more": {"rate": 0}}, "f: [more] rate is 0, but must be a number above 0"),
    "plain type": ({"plain": {"size": "a"}}, "f: [plain] size is 'a', but must be a whole number"),
    "plain rule": ({"plain": {"size": 0}}, "f: [plain] size is 0, but must be positive"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_a_table_is_one_line_that_says_where(mistake):
    table, said = MISTAKES[mistake]
    with pytest.raises(ArgumentError) as caught:
        read_settings(Outer, table, "f:")
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_mistakes_in_python_are_the_same_errors():
    for wrong, said in (
        ({"rate": -1}, "rate is -1, but must be a number above 0"),
        ({"word": "constnt"}, "did you mean 'constant'"),
        ({"number": 5}, "number is 5, but must not be"),
    ):
        with pytest.raises(ArgumentError, match=said):
            Inner(**wrong)
    with pytest.raises(ArgumentError, match="rate is 0"):
        replace(Inner(), rate=0)
    with pytest.raises(ArgumentError, match=r"inner is 3, but must be Inner$"):
        Outer(inner=3)


def test_what_an_annotation_allows_in_words():
    assert described(Annotated[Share, "0 for none"]) == "a number of at least 0 and below 1, 0 for none"
    assert described(Literal["a", "b"] | None) == "one of 'a', 'b'"
    assert described(tuple[int, ...]) == "a list, each of them a whole number"


def test_a_byte_order_mark(tmp_path):
    """As some editors write it."""
    (tmp_path / "a.toml").write_text("seed = 3\n", encoding="utf-8-sig")
    assert read_toml(tmp_path / "a.toml") == {"seed": 3}


def test_files_that_are_no_toml(tmp_path):
    with pytest.raises(ArgumentError, match="cannot be read"):
        read_toml(tmp_path / "gone.toml")
    (tmp_path / "bad.toml").write_text("seed = ")
    with pytest.raises(ArgumentError, match=r"bad\.toml is not valid TOML"):
        read_toml(tmp_path / "bad.toml")


@pytest.mark.process
def test_pydantic_is_loaded_once_settings_are_made_and_not_before():
    code = "import sys, homolog.core.settings; sys.exit('pydantic' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 5000 + "]" * 5000,
        "a = " + "[" * 60 + "]" * 60,
        "a = " + "{a = " * 3000 + "1" + "}" * 3000,
        "[a" + ".b" * 60 + "]",
        "a = " + "9" * 5000,
        "a = " + "9" * 400,
        "a = 0x" + "f" * 5000,
        "a = -9_999_999_999_999_999_999",
        "a = 1\na = 2",
    ],
)
def test_a_file_that_no_reader_should_follow_is_one_line(tmp_path, text):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(ArgumentError, match=r"a\.toml is not valid TOML: ") as caught:
        read_toml(tmp_path / "a.toml")
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400
