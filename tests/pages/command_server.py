"""``homolog`` as the blocks of pages call it in tests: the whole command, where that ends within seconds.

A process loads the command once and forks for each call, which saves most of a short command's time. It listens at the
socket that is its argument; a caller hands over its standard streams, and is told the exit code.

Of what takes hours or never ends, it does a little, by the same road: trainings by recipes that ship take two steps,
sets of made shapes have a few, made bodies are stand-ins for those of anny, and what serves ends once it does.
"""

import json
import os
import signal
import socket
import sys
from dataclasses import replace
from pathlib import Path

from homolog import synthesis, training
from homolog.cli.main import main
from homolog.serving import PageServer
from homolog.serving.server import MatchServer
from homolog.synthesis import production, synthesize_animals, synthesize_people, write_view_dataset
from homolog.training import builtin_recipes, read_recipe

sys.path.insert(0, str(Path(__file__).parents[1] / "synthesis"))
from stand_in import StandIn

STEPS, SHAPES, VERTICES = 2, 6, 800


def read_short_recipe(recipe, changes=None):
    """A recipe; one that ships has few steps."""
    whole = read_recipe(recipe, changes)
    if recipe not in builtin_recipes():
        return whole
    validation = replace(whole.validation, every=STEPS, score_every=0, shapes=2, pairs=1)
    short, none = replace(whole.training, steps=STEPS), replace(whole.orienter, steps=0)
    return replace(whole, training=short, orienter=none, validation=validation)


def few(synthesize):
    """A few bodies, coarsely meshed, made in this process; people are stand-ins."""

    def synthesize_few(output, number, settings, *, processes, **others):
        settings = replace(settings, mesh=replace(settings.mesh, vertices=min(settings.mesh.vertices, VERTICES)))
        return synthesize(output, min(number, SHAPES), settings, processes=1, **others)

    return synthesize_few


def write_few_views(*arguments, views, processes, **others):
    """A few views, made in this process."""
    return write_view_dataset(*arguments, views=min(views, SHAPES), processes=1, **others)


def end_once_it_serves(server):
    """Let a kind of server be interrupted, as by Ctrl-C, as soon as it is to serve."""
    serve_until_interrupted = server.serve

    def serve_and_end(self):
        os.kill(os.getpid(), signal.SIGINT)
        serve_until_interrupted(self)

    server.serve = serve_and_end


def shorten():
    """Put a little in the place of much."""
    training.read_recipe = read_short_recipe
    synthesis.synthesize_people = few(synthesize_people)
    synthesis.synthesize_animals = few(synthesize_animals)
    synthesis.write_view_dataset = write_few_views
    production._body_model = StandIn
    end_once_it_serves(PageServer)
    end_once_it_serves(MatchServer)


def run(arguments, folder, environment, streams):
    """Be the command that was called."""
    for number, stream in enumerate(streams, start=1):
        os.dup2(stream, number)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["homolog", *arguments]
    main()


def answer(caller):
    """Run one call in a process of its own, and tell its exit code."""
    message, streams, _, _ = socket.recv_fds(caller, 1 << 20, 2)
    child = os.fork()
    if child == 0:
        run(*json.loads(message), streams)
    for stream in streams:
        os.close(stream)
    caller.sendall(bytes([os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) % 256]))


def serve(place):
    """Answer calls, one after the other, until this process is ended."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(place)
    listener.listen()
    while True:
        with listener.accept()[0] as caller:
            answer(caller)


if __name__ == "__main__":
    shorten()
    serve(sys.argv[1])
