"""All subcommands of ``homolog``."""

from __future__ import annotations

from typing import Annotated

import typer

from homolog.cli.lazy import lazy_group


def _print_version(*, asked: bool) -> None:
    if asked:
        from homolog.core.versions import version_of

        typer.echo(f"homolog {version_of('homolog')}")
        raise typer.Exit


app = typer.Typer(
    name="homolog",
    cls=lazy_group(
        match="homolog.cli.match:match",
        view="homolog.cli.view:view",
        serve="homolog.cli.serve:serve",
        transfer="homolog.cli.transfer:transfer",
        export="homolog.cli.export:export",
        symmetry="homolog.cli.symmetry:symmetry",
        fit="homolog.cli.fit:fit",
        collection="homolog.cli.collection:collection",
        compare="homolog.cli.compare:compare",
        complete="homolog.cli.complete:complete",
        track="homolog.cli.track:track",
        train="homolog.cli.train:train",
        evaluate="homolog.cli.evaluate:evaluate",
        reproduce="homolog.cli.reproduce:reproduce",
        reconstruct="homolog.cli.reconstruct:reconstruct",
        info="homolog.cli.info:info",
        doctor="homolog.cli.doctor:doctor",
        demo="homolog.cli.demo:demo",
        synth="homolog.cli.synth:synth",
        volume="homolog.cli.volume:volume",
        data="homolog.cli.data:data",
    ),
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


@app.callback()
def options_of_homolog(
    *,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Find dense correspondences between non-rigid 3D shapes: meshes and point clouds, full or partial."""
