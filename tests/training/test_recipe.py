"""Recipes: what is read is what was written, and every mistake is one line that says where."""

from dataclasses import fields, is_dataclass

import pytest

from homolog.core.errors import ArgumentError
from homolog.core.settings import read_toml
from homolog.training.losses import BUILTIN_LOSSES
from homolog.training.recipes import builtin_recipes, find_recipe, read_recipe, recipe_from
from homolog.training.settings import CloudSettings, LossSettings, PartialSettings, Recipe


def written(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return path


def test_an_empty_recipe_is_the_default(tmp_path):
    assert read_recipe(written(tmp_path, "")) == Recipe()


def test_values_arrive_with_their_types(tmp_path):
    found = read_recipe(
        written(
            tmp_path,
            """
            name = "bones"
            seed = 7
            [clouds]
            noise = [0.01, 1]
            resampled = [2000]
            [optimiser]
            learning_rate = 1
            betas = [0.8, 0.95]
            schedule = "one-cycle"
            [loss]
            raw_products = true
            [partial]
            """,
        )
    )
    assert (found.name, found.seed, found.loss.raw_products) == ("bones", 7, True)
    assert found.clouds == CloudSettings(noise=(0.01, 1.0), resampled=(2000,))
    assert isinstance(found.clouds.noise[1], float)
    assert isinstance(found.optimiser.learning_rate, float)
    assert (found.optimiser.betas, found.optimiser.schedule) == ((0.8, 0.95), "one-cycle")
    assert found.partial == PartialSettings()
    assert Recipe().partial is None


MISTAKES = {
    "[optimiser]\nlearning_rte = 1": ["[optimiser]", "unknown key 'learning_rte'", "did you mean 'learning_rate'?"],
    "[optimizer]\nlearning_rate = 1": ["unknown key 'optimizer'", "did you mean 'optimiser'?"],
    "[training]\nzzz = 1": ["[training]", "unknown key 'zzz'", "it knows steps, pairs_per_step"],
    "[training]\nsteps = 1.5": ["[training] steps is 1.5", "a whole number"],
    "[training]\nsteps = true": ["[training] steps is True", "a whole number"],
    "[training]\nsteps = -1": ["[training] steps is -1", "at least 0"],
    "[training]\nprecision = '16'": ["[training] precision is '16'", "32, bf16"],
    "[training]\nprecision = 32": ["[training] precision is 32", "one of '32', 'bf16'"],
    "[optimiser]\nlearning_rate = nan": ["[optimiser] learning_rate is nan", "a number above 0"],
    "[optimiser]\nlearning_rate = 'high'": ["[optimiser] learning_rate is 'high'", "a number"],
    "[optimiser]\nbetas = [0.9]": ["[optimiser] betas is [0.9]", "a list of 2"],
    "[optimiser]\nbetas = [0.9, 1.0]": ["[optimiser] betas holds 1.0", "below 1"],
    "[optimiser]\nschedule = 'cosin'": ["[optimiser] schedule is 'cosin'", "did you mean 'cosine'?"],
    "[clouds]\nnoise = 0.01": ["[clouds] noise is 0.01", "a list, each of them a number"],
    "[clouds]\nnoise = [0.01, 'x']": ["[clouds] noise holds 'x'", "a list, each of them a number above 0"],
    "[clouds]\ncut = [0.05]": ["[clouds] cut holds 0.05", "a number of at least 0.1 and below 1"],
    "[clouds]\ncut = [0.5, 0.2]": ["[clouds] cut is 0.2", "at least 0.21, where twice [operators] n_eigenpairs"],
    "[clouds]\nholes = [0]": ["[clouds] holes holds 0", "each of them a whole number of at least 1"],
    "[clouds]\nviews = [-0.1]": ["[clouds] views holds -0.1", "at least 0"],
    "[clouds]\nsubsampled = [1.5]": ["[clouds] subsampled holds 1.5", "above 0 and below 1"],
    "[augmentation]\nturn = 'sideways'": ["[augmentation] turn is 'sideways'", "vertical"],
    "[validation]\nshapes = 1": ["[validation] shapes is 1", "at least 2"],
    "[network]\nwidth = -3": ["[network] width is -3", "at least 1"],
    "input = 'xyz+wks'": ["[network] in_channels is 3", "more than 3, for positions and signatures"],
    "input = 'wks'": ["input is 'wks'", "xyz, xyz+wks"],
    "[network]\nin_channels = 16": ["[network] in_channels is 16", "3, for positions"],
    "[loss]\nmap_eigenpairs = 300": ["[loss] map_eigenpairs is 300", "at most n_eigenpairs, 128"],
    "[loss]\nbijectivty = 1.0": ["[loss] has an unknown key 'bijectivty'", "did you mean 'bijectivity'?"],
    "[loss]\nsoft_temprature = 1.0": [
        "[loss] has an unknown key 'soft_temprature'",
        "did you mean 'soft_temperature'?",
    ],
    "[loss]\ninfonce = -1": ["[loss] infonce is -1", "a number of at least 0"],
    "[loss]\ninfonce = nan": ["[loss] infonce is nan", "a number of at least 0"],
    "[loss]\ninfonce = 'much'": ["[loss] infonce is 'much'", "a number of at least 0"],
    "[loss]\ninfonce = true": ["[loss] infonce is True", "a number of at least 0"],
    "[loss.functions]\ninfonce = 'a:b'": ["[loss.functions] has 'infonce'", "give yours another name"],
    "loss = 3": ["loss is 3", "a section [loss]"],
    "upright = 1": ["upright is 1", "true or false"],
    "[samples]\npoints = 200": ["[samples] points is 200", "at least twice [operators] n_eigenpairs, 256"],
    "[data]\nup = 'Z'": ["[data] up is 'Z'", "x, y, z"],
    "training = 3": ["training is 3", "a section [training]"],
    "[partial]\n[loss]\nregistration = 1.0": ["[loss] registration is 1.0", "0 with a section [partial]"],
    "seed = -1": ["seed is -1", "at least 0"],
    "name = 3": ["name is 3", "a text in quotes"],
    "seed = ": ["not valid TOML"],
}


@pytest.mark.parametrize("text", MISTAKES)
def test_a_mistake_is_one_line_that_says_where(tmp_path, text):
    path = written(tmp_path, text)
    with pytest.raises(ArgumentError) as caught:
        read_recipe(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    for words in MISTAKES[text]:
        assert words in message


def test_a_recipe_that_is_not_there(tmp_path):
    with pytest.raises(ArgumentError, match=r"recipe is 'quik'.*did you mean 'quick'.*TOML file"):
        find_recipe("quik")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ArgumentError, match="cannot be read"):
        read_recipe(tmp_path / "binary.toml")


@pytest.mark.parametrize(
    "name",
    [
        "faust",
        "scape",
        "paper_faust",
        "paper_scape",
        "quick",
        "cuts",
        "holes",
        "views",
        "animal_parts",
        "people_parts",
        "people",
        "organs",
    ],
)
def test_shipped_recipes_can_be_read(name):
    recipe = read_recipe(name)
    assert builtin_recipes()[name].stem == name
    assert recipe.name == name
    assert recipe.licence != "unknown"
    assert (recipe.partial is not None) == (name in ("cuts", "holes", "views", "animal_parts", "people_parts"))


def test_every_setting_is_documented():
    """Each field of each section is named in its docstring."""

    def check(settings):
        for field in fields(settings):
            documented = "".join(base.__doc__ or "" for base in settings.__mro__)
            assert f"{field.name}: " in documented, f"{settings.__name__}.{field.name}"
            value = getattr(settings(), field.name)
            if is_dataclass(value):
                check(type(value))

    check(Recipe)
    check(PartialSettings)


def test_built_in_recipes_say_what_their_weights_are_for():
    """Both keys stand in each file, whatever its losses and its augmentation are."""
    for path in builtin_recipes().values():
        table = read_toml(path)
        assert {"upright", "near_isometric"} <= table.keys(), path
        assert table["near_isometric"] == (path.stem != "organs")


def test_a_weight_that_is_absent_is_the_default_and_others_stay():
    found = recipe_from({"loss": {"infonce": 5, "map_eigenpairs": 20}}, "f").loss
    assert found == LossSettings(weights={"infonce": 5.0}, map_eigenpairs=20)
    assert found.weights == {**LossSettings().weights, "infonce": 5.0}
    assert {name: loss.weight for name, loss in BUILTIN_LOSSES.items()} == LossSettings().weights


def test_the_schema_knows_every_key():
    schema = Recipe.json_schema()
    loss = schema["$defs"]["LossSettings"]
    assert set(loss["properties"]) == {*BUILTIN_LOSSES, *(f.name for f in fields(LossSettings))} - {"weights"}
    assert set(schema["properties"]) == {f.name for f in fields(Recipe)}
    assert schema["$defs"]["OptimiserSettings"]["properties"]["schedule"]["enum"] == ["cosine", "constant", "one-cycle"]
    assert schema["$defs"]["TrainingSettings"]["properties"]["pairs_per_step"]["minimum"] == 1
