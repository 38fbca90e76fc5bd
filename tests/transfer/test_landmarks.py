"""Landmarks: read from tables and Slicer's formats, carried, and written back as they were."""

import json

import numpy as np
import pytest

from homolog.core.errors import DataError
from homolog.shapes import Shape
from homolog.transfer import Transfer, read_landmarks

POINTS = np.array([[1.5, -2.0, 3.25], [0.1, 0.2, -0.3], [7.0, 8.0, 9.0]])


def markups(system="LPS", **changes):
    points = [
        {"id": str(i), "label": f"P-{i}", "position": point, "positionStatus": "defined"}
        for i, point in enumerate(POINTS.tolist())
    ]
    head = {"type": "Fiducial", "coordinateSystem": system, "controlPoints": points, "measurements": [{"name": "l"}]}
    return {"@schema": "https://example.org/markups-schema-v1.0.3.json#", "markups": [head | changes]}


def fcsv(system="LPS"):
    rows = [f'vtk_{i},{x},{y},{z},0,0,0,1,1,1,0,"a, b",,' for i, (x, y, z) in enumerate(POINTS.tolist())]
    return "\n".join(
        [
            "# Markups fiducial file version = 4.11",
            f"# CoordinateSystem = {system}",
            "# columns = id,x,y,z,ow",
            *rows,
            "",
        ]
    )


@pytest.mark.parametrize("system", ["LPS", "RAS"])
def test_markups_go_round(tmp_path, system):
    path, content = tmp_path / "a.mrk.json", markups(system)
    path.write_text(json.dumps(content))
    found = read_landmarks(path)
    assert found.system == system
    np.testing.assert_array_equal(found.points, POINTS)
    turned = POINTS * ([1, 1, 1] if system == "LPS" else [-1, -1, 1])
    np.testing.assert_array_equal(found.points_in("LPS"), turned)
    found.write_from(tmp_path / "b.mrk.json", turned + np.array([1, 0, 0]), "LPS")
    written = json.loads((tmp_path / "b.mrk.json").read_text())
    expected = POINTS + np.array([1 if system == "LPS" else -1, 0, 0])
    np.testing.assert_allclose([point["position"] for point in written["markups"][0]["controlPoints"]], expected)
    # All else stays, but measurements of the other shape.
    lists = [file["markups"][0]["controlPoints"] for file in (written, content)]
    for point, before in zip(*lists, strict=True):
        assert point | {"position": 0} == before | {"position": 0}
    assert "measurements" not in written["markups"][0] and written["@schema"] == content["@schema"]
    assert written["markups"][0]["coordinateSystem"] == system
    assert json.loads(path.read_text()) == content


def test_markups_that_are_lost_are_undefined(tmp_path):
    path = tmp_path / "a.mrk.json"
    content = markups()
    content["markups"][0]["controlPoints"][0]["positionStatus"] = "undefined"
    path.write_text(json.dumps(content))
    found = read_landmarks(path)
    np.testing.assert_array_equal(np.isnan(found.points).all(axis=1), [True, False, False])
    moved = found.points.copy()
    moved[1] = np.nan
    found.write_from(path, moved, "LPS")
    points = json.loads(path.read_text())["markups"][0]["controlPoints"]
    assert [point["positionStatus"] for point in points] == ["undefined", "undefined", "defined"]


@pytest.mark.parametrize(("name", "system"), [("LPS", "LPS"), ("RAS", "RAS"), ("0", "RAS"), ("1", "LPS")])
def test_fcsv_goes_round(tmp_path, name, system):
    path = tmp_path / "a.fcsv"
    path.write_text(fcsv(name))
    found = read_landmarks(path)
    assert found.system == system
    np.testing.assert_array_equal(found.points, POINTS)
    found.write_from(tmp_path / "b.fcsv", found.points_in("RAS"), "RAS")
    assert (tmp_path / "b.fcsv").read_text() == path.read_text()
    moved = found.points_in("LPS").copy()
    moved[1] = np.nan
    moved[2] += 1.0
    found.write_from(tmp_path / "b.fcsv", moved, "LPS")
    again = read_landmarks(tmp_path / "b.fcsv")
    step = np.array([1.0, 1.0, 1.0]) if system == "LPS" else np.array([-1.0, -1.0, 1.0])
    np.testing.assert_allclose(again.points, [POINTS[0], POINTS[2] + step])
    assert (tmp_path / "b.fcsv").read_text().splitlines()[-1].endswith('0,0,0,1,1,1,0,"a, b",,')


def test_an_old_fcsv_is_in_ras(tmp_path):
    (tmp_path / "a.fcsv").write_text("# Fiducial List file\nF1,1,2,3,1,1\n")
    assert read_landmarks(tmp_path / "a.fcsv").system == "RAS"


def test_tables_go_round(tmp_path):
    path = tmp_path / "a.csv"
    text = '# of a face\nname,Y,X,Z,note\n"tip, nose",2.0,1.0,3.0,"one two"\n\nchin,5.0,4.0,6.0,\n'
    path.write_text(text)
    found = read_landmarks(path)
    assert found.system is None
    np.testing.assert_array_equal(found.points, [[1, 2, 3], [4, 5, 6]])
    found.write_from(tmp_path / "b.csv", found.points_in("RAS"), "RAS")
    assert (tmp_path / "b.csv").read_text() == text.replace('"one two"', "one two")
    found.write_from(tmp_path / "b.csv", np.array([[np.nan] * 3, [7.0, 8.0, 9.5]]), "LPS")
    lines = (tmp_path / "b.csv").read_text().splitlines()
    assert lines[2] == '"tip, nose",nan,nan,nan,one two' and lines[4] == "chin,8.0,7.0,9.5,"
    (tmp_path / "a.xyz").write_text("1 2 3\n4 5 6\n")
    bare = read_landmarks(tmp_path / "a.xyz")
    bare.write_from(tmp_path / "b.xyz", bare.points, "LPS")
    assert (tmp_path / "b.xyz").read_text() == "1.0 2.0 3.0\n4.0 5.0 6.0\n"


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("name;x;y;z\na;1,5;2;3\nb;4;5,25;6\n", "name;x;y;z\na;11,5;12.0;13.0\nb;14.0;15,25;16.0\n"),
        ('name;x;y;z\n"tip, nose";1,5;2;3\nb;4;5,25;6\n', "name;x;y;z\ntip, nose;11,5;12.0;13.0\nb;14.0;15,25;16.0\n"),
        ("1,5  2,0  3,0\n4,0  5,25  6,0\n", "11,5 12,0 13,0\n14,0 15,25 16,0\n"),
        (
            'i,name,x,y,z\n1, "n,m",1.5,2,3\n2,b,4,5.25,6\n',
            'i,name,x,y,z\n1,"n,m",11.5,12.0,13.0\n2,b,14.0,15.25,16.0\n',
        ),
        ("y,z\na,1.5,2,3\nb,4,5.25,6\n", "y,z\na,11.5,12.0,13.0\nb,14.0,15.25,16.0\n"),
        ("skull\n1.5 2 3\n4 5.25 6\n", "skull\n11.5 12.0 13.0\n14.0 15.25 16.0\n"),
    ],
)
def test_tables_are_written_as_they_were(tmp_path, text, written):
    (tmp_path / "a.csv").write_text(text)
    found = read_landmarks(tmp_path / "a.csv")
    np.testing.assert_array_equal(found.points, [[1.5, 2, 3], [4, 5.25, 6]])
    found.write_from(tmp_path / "b.csv", found.points + 10, "RAS")
    assert (tmp_path / "b.csv").read_text() == written
    np.testing.assert_array_equal(read_landmarks(tmp_path / "b.csv").points, found.points + 10)


def test_a_table_keeps_landmarks_without_a_position(tmp_path):
    (tmp_path / "a.csv").write_text("name,x,y,z\na,,,\nb,4,5,6\n")
    found = read_landmarks(tmp_path / "a.csv")
    np.testing.assert_array_equal(found.points, [[np.nan] * 3, [4, 5, 6]])
    found.write_from(tmp_path / "b.csv", found.points, "RAS")
    assert (tmp_path / "b.csv").read_text() == "name,x,y,z\na,nan,nan,nan\nb,4.0,5.0,6.0\n"


def scalismo():
    """As scalismo writes it: a list of landmarks, some with what else it knows."""
    uncertainty = {"stddevs": [1.0, 2.0, 3.0], "pcvectors": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}
    first, second, third = ({"id": name, "coordinates": at} for name, at in zip("ABC", POINTS.tolist(), strict=True))
    return [
        {**first, "description": "a tip", "extensions": {"seen": True}},
        second,
        {**third, "uncertainty": uncertainty},
    ]


def test_scalismos_json_goes_round(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(scalismo()))
    found = read_landmarks(path)
    assert found.system is None and found.names == ("A", "B", "C") and found.suffix == ".json"
    np.testing.assert_array_equal(found.points, POINTS)
    found.write_from(tmp_path / "b.json", found.points_in("RAS") + 1, "RAS")
    written = json.loads((tmp_path / "b.json").read_text())
    np.testing.assert_array_equal([each["coordinates"] for each in written], POINTS + 1)
    assert written[0] | {"coordinates": 0} == scalismo()[0] | {"coordinates": 0}
    assert list(written[2]) == ["id", "coordinates"]  # its directions were those of the other shape
    found.write_from(tmp_path / "b.json", np.array([POINTS[0], [np.nan] * 3, POINTS[2]]), "LPS")
    assert read_landmarks(tmp_path / "b.json").names == ("A", "C")


@pytest.mark.parametrize(
    "names", [("nose", "chin", "ear"), ("7", "3", "ear"), ("12", "30", "4"), ("nose, tip", "a", "b")]
)
@pytest.mark.parametrize("points", [POINTS, np.arange(9.0).reshape(3, 3)])
@pytest.mark.parametrize("comment", ["", "# made by hand\n"])
def test_scalismos_tables_have_a_name_and_three_numbers(tmp_path, names, points, comment):
    quoted = [f'"{name}"' if "," in name else name for name in names]
    rows = [f"{name},{x:g},{y:g},{z:g}" for name, (x, y, z) in zip(quoted, points.tolist(), strict=True)]
    (tmp_path / "a.csv").write_text(comment + "\n".join(rows) + "\n")
    found = read_landmarks(tmp_path / "a.csv")
    assert found.names == names
    np.testing.assert_array_equal(found.points, points)
    found.write_from(tmp_path / "b.csv", points + 1, "LPS")
    again = read_landmarks(tmp_path / "b.csv")
    assert again.names == names
    np.testing.assert_array_equal(again.points, points + 1)


@pytest.mark.parametrize(
    ("name", "content", "names"),
    [
        ("a.mrk.json", json.dumps(markups()), ("P-0", "P-1", "P-2")),
        ("a.fcsv", fcsv(), ("vtk_0", "vtk_1", "vtk_2")),
        ("a.fcsv", "# columns = id,x,y,z,vis,sel,label\n1,1,2,3,1,1,tip\n2,1,2,3,1,1,\n", ("tip", "2")),
        ("a.csv", "x,y,z,name\n1,2,3,tip\n4,5,6,\n", ("tip", "2")),
        ("a.xyz", "1 2 3\n4 5 6\n", ("1", "2")),
    ],
)
def test_names(tmp_path, name, content, names):
    (tmp_path / name).write_text(content)
    assert read_landmarks(tmp_path / name).names == names


@pytest.mark.parametrize("axes", ["lps", "ras"])
def test_tables_of_slicer_name_their_system(tmp_path, axes):
    (tmp_path / "a.csv").write_text(f"label,{','.join(axes)},defined\nF,1,2,3,1\nG,4,5,6,1\n")
    found = read_landmarks(tmp_path / "a.csv")
    assert found.system == axes.upper()
    np.testing.assert_array_equal(found.points, [[1, 2, 3], [4, 5, 6]])


def test_landmarks_go_along(make, matched):
    """Points of the surface, onto a moved copy; one whose surroundings have no counterpart is lost."""
    shape, turn = make.blob(3), make.rotation(2)
    other = Shape(shape.points @ turn.T * 10 + 5, shape.faces)
    same = np.arange(shape.n_points)
    there = np.where(shape.points[:, 1] > 1.0, -1, same)
    transfer = Transfer(matched(shape, other, there, there))
    low = np.flatnonzero(shape.points[shape.faces].max(axis=1)[:, 1] < 0.8)[:40]
    top = shape.points[[shape.points[:, 1].argmax()]]
    points = np.concatenate([shape.points[shape.faces[low]].mean(axis=1), top])
    carried, away = transfer.landmarks(np.concatenate([points, [[np.nan] * 3]]))
    np.testing.assert_allclose(carried[:40], points[:40] @ turn.T * 10 + 5, atol=0.01)
    assert np.isnan(carried[40:]).all() and np.isnan(away[41])
    np.testing.assert_allclose(away[:41], 0.0, atol=1e-6)
    _, away = transfer.landmarks(np.array([[0.0, -50.0, 0.0]]))
    assert away[0] > 40


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.mrk.json", "{", "no valid JSON"),
        ("a.mrk.json", "[]", "no list 'markups'"),
        ("a.mrk.json", "[" * 100_000, "too deep in each other"),
        ("a.mrk.json", '{"markups": ' + "[" * 60 + "]" * 60 + "}", "nested too deep"),
        ("a.mrk.json", json.dumps({"markups": [{"controlPoints": 5}]}), "no control points"),
        ("a.mrk.json", json.dumps(markups(controlPoints=[{"position": [10**400, 0, 2]}])), "more than 64 bits"),
        ("a.mrk.json", json.dumps({"markups": [{"controlPoints": []}]}), "no control points"),
        ("a.mrk.json", json.dumps(markups("IJK")), "coordinate systems are IJK"),
        ("a.mrk.json", json.dumps(markups(controlPoints=[{"position": [1, "x", 2]}])), "three numbers"),
        ("a.fcsv", "# CoordinateSystem = 2\n0,1,2,3\n", "coordinate system is 2"),
        ("a.fcsv", "# nothing\n", "holds no landmarks"),
        ("a.fcsv", "F,1,2\n", "too few"),
        ("a.csv", "x,y,z\n", "holds no landmarks"),
        ("a.csv", "label,x,y,z\nF,1,2,3\n" + "G" * 200_000 + ",1,2,3\n", "no row of a table .* 131072 characters"),
        ("a.csv", "p,q,r,s\n1,2,3,4\n", "its columns are named"),
        ("a.csv", "skull\na\nb\n", "the line 'a' is one value"),
        ("a.csv", "y,z\n1,2\n3,4\n", "named y, z; an x is missing"),
        ("a.csv", "# skull\n1\n2\n", "the line '2' is one value"),
        ("a.csv", "name,x,y,z\na,,2,3\n", "should hold numbers"),
        ("a.csv", 'i,name,x,y,z\n1, "n,1,2,3\n', "should hold numbers"),
        ("a.vtk", "{}", "must have one of"),
        ("a.json", "{}", "no list of landmarks with 'id' and 'coordinates'"),
        ("a.json", "[]", "holds no landmarks"),
        ("a.json", '[{"id": "A"}]', "no list of landmarks with 'id' and 'coordinates'"),
        ("a.json", '[{"id": 3, "coordinates": [1, 2, 3]}]', "no list of landmarks with 'id' and 'coordinates'"),
        ("a.json", '[{"id": "A", "coordinates": [1, 2]}]', "three numbers"),
        ("a.json", '[{"id": "A", "coordinates": [1, 2, NaN]}]', "cannot be read as landmarks"),
        ("a.json", "[", "no valid JSON"),
        ("a.json", json.dumps(markups()), "are called .mrk.json"),
        ("a.csv", None, "No such file"),
    ],
)
def test_faults_of_files(tmp_path, name, content, told):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(DataError, match=told) as raised:
        read_landmarks(tmp_path / name)
    assert "\n" not in str(raised.value) and name in str(raised.value)


def test_a_quote_that_does_not_end_is_named(tmp_path):
    path = tmp_path / "a.fcsv"
    path.write_text('1,0,0,0,0,0,0,1,1,1,0,"' + "x" * 200_000 + "\n")
    with pytest.raises(DataError, match=r"a\.fcsv .*is no row of a table \(.*\); correct or remove it$"):
        read_landmarks(path)
