"""The page in Chromium: two users at once, a hostile upload between them, pages that are closed."""

import zipfile

import numpy as np
import pytest
from serving_tools import gone, pids, program, until

from homolog.matching import Match
from homolog.serving import MatchCommand

pytest.importorskip("uvicorn", reason="uvicorn is missing; pip install 'homolog[serve]'")
pytestmark = pytest.mark.browser


@pytest.fixture
def user(tab):
    """``user(server)`` is a tab of its own, with the page open."""

    def new(server):
        one = tab(1000, 640)
        one.page.goto(server.address)
        return one.page, one

    return new


def choose(page, side, *files):
    page.set_input_files(f"[data-side={side}] input", files)


def drop(page, side, name, content):
    """Drop a file on a zone, as a mouse does."""
    data = page.evaluate_handle(
        """([name, content]) => {
          const data = new DataTransfer();
          data.items.add(new File([content], name));
          return data;
        }""",
        [name, content],
    )
    page.dispatch_event(f"[data-side={side}]", "drop", {"dataTransfer": data})


def download(page, folder):
    """The result as the user gets it."""
    with page.expect_download() as waited:
        page.click("#download")
    waited.value.save_as(folder / "got.zip")
    with zipfile.ZipFile(folder / "got.zip") as archive:
        archive.extractall(folder)
    return waited.value.suggested_filename, Match.load(folder / "homolog-result")


def seen(page):
    """What the map says of itself, once it is drawn."""
    page.wait_for_selector("body.result")
    frame = page.frame_locator("#map")
    frame.locator("body[data-ready]").wait_for()
    return frame.locator("h1").inner_text()


def complaint(page):
    page.wait_for_selector("#complaint:not([hidden])")
    return page.inner_text("#complaint")


def test_two_users_and_a_hostile_one(serve, user, blobs, demo_folder, demo, tmp_path):
    """Both get their own maps at once, while a third gets one message; and nothing of it stays on the server."""
    server = serve(MatchCommand(), jobs=2)
    (ann, of_ann), (ben, of_ben), (eve, of_eve) = (user(server) for _ in range(3))
    bodies = [demo_folder / "off" / f"{name}.off" for name in ("amber", "boris")]
    for side, body, blob in zip(("source", "target"), bodies, blobs, strict=True):
        choose(ann, side, body)
        choose(ben, side, blob)
    drop(eve, "source", "<img src=x onerror=alert(1)>.off", "OFF\n1000000000 1 0\n")
    drop(eve, "target", "b.off", "OFF\n")
    ann.wait_for_selector("#steps li")
    said = complaint(eve)
    assert said.startswith("_img src=x onerror=alert(1)_.off could not be read as OFF: ")
    assert "1000000000 points" in said and str(server.folder) not in said
    assert eve.inner_text("[data-side=source] .name") == "<img src=x onerror=alert(1)>.off"
    assert eve.query_selector("img") is None
    assert seen(ben) == "one.off → other.ply" and seen(ann) == "amber.off → boris.off"
    for page, name in ((ann, "amber to boris.zip"), (ben, "one to other.zip")):
        (tmp_path / name).mkdir()
        got, result = download(page, tmp_path / name)
        assert got == name
        if page is ann:  # the truth is known
            near = np.linalg.norm(demo.amber.points[result.target_to_source[demo.boris_points]]
                                  - demo.amber.points[demo.amber_points], axis=1)  # fmt: skip
            assert np.median(near) < 0.05 * np.ptp(demo.amber.points[:, 1])
        else:
            assert result.source.n_points == 162
    # The pages have their results and said so: the server keeps nothing, though both are open.
    until(lambda: not any(server.folder.iterdir()))
    for one in (of_ann, of_ben, of_eve):
        assert one.complaints == []
        assert all(url.startswith((server.address, f"blob:{server.address}", "data:")) for url in one.requests)


def click_foremost(page, number):
    """Click the point of a shape that is nearest to the camera, in the page of the match; its number."""
    inside = next(frame for frame in page.frames if frame.url.endswith("view.html"))
    camera = inside.evaluate("side => homolog.camera(side)", number)
    points = np.reshape(inside.evaluate("side => homolog.points(side)", number), (-1, 3))
    view, clip = (np.reshape(camera[name], (4, 4)).T for name in ("view", "clip"))
    x, y, depth, w = clip @ view @ np.concatenate([points, np.ones((len(points), 1))], axis=1).T
    point, part = int((depth / w).argmin()), camera["part"]
    at = part["left"] + (x / w + 1)[point] / 2 * part["width"], (1 - y / w)[point] / 2 * part["height"]
    page.frame_locator("#map").locator("#canvas").click(position={"x": float(at[0]), "y": float(at[1])})
    return point


def test_landmarks_match_again_and_maps_are_chosen(serve, user, blobs, tmp_path):
    """The new match meets what was clicked, and shows it; cancelling, or a failure, leads back to the one before."""
    server = serve(MatchCommand(("--method=registration",)))
    page, one = user(server)
    page.select_option("#alternatives", "2")
    choose(page, "source", *blobs)
    seen(page)
    frame = page.frame_locator("#map")
    frame.locator("#set").click()
    clicked = [click_foremost(page, number) for number in (0, 1)]
    assert not frame.locator("#run").is_visible()
    with page.expect_download() as waited:  # the sandboxed page may save
        frame.locator("#save-0").click()
    assert waited.value.suggested_filename == "one-landmarks.mrk.json"
    frame.locator("#again").click()
    page.click("#cancel")
    page.wait_for_selector("body.result")
    assert frame.locator("#landmarks li").count() == 1 and page.is_hidden("#complaint-of-result")
    with page.expect_request("**/jobs"):  # however short the match, and however lately the frame was shown again
        frame.locator("#again").evaluate("button => button.click()")
    seen(page)
    got, result = download(page, tmp_path)
    assert got == "one to other.zip" and result.source_to_target[clicked[0]] == clicked[1]
    assert frame.locator("#landmarks li").inner_text().split("\n")[:2] == ["1", f"{clicked[0]} → {clicked[1]}"]
    frame.locator("#map").select_option(index=1)
    page.wait_for_selector("#download:has-text('Download alternative 2')")
    (tmp_path / "other").mkdir()
    got, other = download(page, tmp_path / "other")
    assert got == "one to other (alternative 2).zip"
    assert (other.source_to_target != result.source_to_target).any()
    until(lambda: not any(server.folder.iterdir()))
    server.end()
    frame.locator("#again").click()
    page.wait_for_selector("#complaint-of-result:not([hidden])")
    assert page.is_visible("#map") and frame.locator("#landmarks li").count() == 1
    assert all("/jobs" not in url for url in one.requests if not url.startswith(server.address))


def test_no_one_else_asks_the_page_for_a_match(serve, user, stuck, blobs):
    """Messages count that come from the page of the match, while it is shown."""
    page, one = user(serve(stuck))
    choose(page, "source", *blobs)
    page.wait_for_selector("#steps li")
    page.click("#cancel")  # now it has two files, and might match them
    asked = [url for url in one.requests if url.endswith("/jobs")]
    page.evaluate("document.body.classList.add('result')")
    page.evaluate("window.postMessage({homolog: 'match again', landmarks: {source: [1], target: [2]}}, '*')")
    page.evaluate("() => new Promise((done) => setTimeout(done, 200))")
    assert [url for url in one.requests if url.endswith("/jobs")] == asked and len(asked) == 1


def test_the_zone_of_the_bad_file_is_marked(serve, user):
    """Though both files are called alike, and otherwise on the server than here."""
    bad = '{"step": "read target", "side": "target", "done": 1, "total": 9}\n{"error": "target/_a_.off is empty"}'
    page, _ = user(serve(program(f"import sys; print({bad!r}, file=sys.stderr); sys.exit(2)")))
    for side in ("source", "target"):
        drop(page, side, "<a>.off", "OFF\n")
    assert complaint(page) == "the target _a_.off is empty"
    assert [zone.get_attribute("data-side") for zone in page.query_selector_all(".zone.wrong")] == ["target"]


def test_a_page_that_closes_ends_its_match(serve, user, stuck, blobs):
    server = serve(stuck)
    page, _ = user(server)
    for side, blob in zip(("source", "target"), blobs, strict=True):
        choose(page, side, blob)
    page.wait_for_selector("#steps li:has-text('read source')")
    started = until(lambda: pids(server))
    page.close()
    until(lambda: gone(started) and not any(server.folder.iterdir()))


def test_cancelling_and_beginning_anew(serve, user, stuck, blobs):
    server = serve(stuck)
    page, one = user(server)
    choose(page, "source", *blobs)  # both at once
    started = until(lambda: pids(server))
    page.click("#cancel")
    until(lambda: gone(started) and not any(server.folder.iterdir()))
    assert page.is_hidden("#work") and page.is_enabled("#match")
    page.select_option("#partial", "source")
    page.click("#match")
    page.wait_for_selector("#steps li")
    assert until(lambda: pids(server)) != started
    assert one.complaints == []


def test_what_the_page_refuses_by_itself(serve, user, stuck, tmp_path):
    page, one = user(serve(stuck, max_mb=0.01))
    (tmp_path / "large.off").write_bytes(bytes(20_000))
    (tmp_path / "empty.off").touch()
    (tmp_path / "notes.docx").write_bytes(b"x")
    for name, said in (
        ("large.off", "larger than 0.01 MB"),
        ("empty.off", "is empty"),
        ("notes.docx", "suffix '.docx'"),
    ):
        choose(page, "target", tmp_path / name)
        assert complaint(page).startswith(name) and said in complaint(page)
        assert page.is_disabled("#match")
    assert not any("/jobs" in url for url in one.requests)
    assert one.complaints == []


def test_a_server_that_goes_away(serve, user, stuck, blobs):
    server = serve(stuck)
    page, _ = user(server)
    choose(page, "source", *blobs)
    page.wait_for_selector("#steps li")
    server.end()
    assert "connection to the server is lost" in complaint(page)
    assert page.is_enabled("#match")
