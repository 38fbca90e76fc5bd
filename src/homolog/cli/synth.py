"""``homolog synth``: synthetic shapes for training and tests."""

from homolog.cli.lazy import lazy_typer

synth = lazy_typer(
    "synth",
    help="Make shapes for training and tests, with ground truth.",
    people="homolog.cli.synth_people:people",
    hands="homolog.cli.synth_hands:hands",
    heads="homolog.cli.synth_heads:heads",
    animals="homolog.cli.synth_animals:animals",
    bones="homolog.cli.synth_bones:bones",
    organs="homolog.cli.synth_organs:organs",
    views="homolog.cli.synth_views:views",
    meshings="homolog.cli.synth_meshings:meshings",
    part="homolog.cli.synth_part:part",
)
