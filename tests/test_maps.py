"""Maps of ROS's map server as scenes: right side up, with thresholds, and refused if anything is odd."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from loewner import Body, FileError, InputError, Scene, collide
from loewner.scenes.maps import read_map, rectangles

TEXT = """image: {image}
resolution: 0.5
origin: [{x}, {y}, {yaw}]
negate: {negate}
occupied_thresh: 0.65
free_thresh: 0.196
"""


def written(folder, pixels, *, image="map.pgm", x=-1.0, y=2.0, yaw=0.0, negate=0, plain=False, more=""):
    """A map with these grey values, the first row on top."""
    pixels = np.asarray(pixels)
    head = f"{'P2' if plain else 'P5'}\n# a comment\n{pixels.shape[1]} {pixels.shape[0]}\n255\n".encode()
    body = b" ".join(b"%d" % v for v in pixels.ravel()) if plain else pixels.astype("u1").tobytes()
    (folder / "map.pgm").write_bytes(head + body)
    path = folder / "map.yaml"
    path.write_text(TEXT.format(image=image, x=x, y=y, yaw=yaw, negate=negate) + more)
    return path


def at(x, y, z=0.25):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def hits(scene, x, y, z=0.25):
    """Whether a small ball there touches the map."""
    return "map" in scene and collide(Body.sphere(1e-3), at(x, y, z), scene["map"], scene.pose("map"))


BLACK, WHITE, GREY = 0, 254, 205


def test_landmarks_are_where_the_image_shows_them(tmp_path):
    """A pillar in the upper left corner of the image is at low x and high y."""
    pixels = np.full((4, 6), WHITE)
    pixels[0, 0] = BLACK
    for plain in (False, True):
        scene = Scene.from_map(written(tmp_path, pixels, plain=plain), height=0.5)
        assert hits(scene, -0.75, 3.75)
        assert not any(hits(scene, x, y) for x, y in [(-0.75, 2.25), (1.75, 3.75), (1.75, 2.25), (-0.75, 3.2)])
        assert not hits(scene, -0.75, 3.75, 0.6)


# Values of occupied, free and unknown cells, in the image's own colours.
MAPS = {
    "trinary": {"colours": (0, 254, 205)},
    "negated": {"colours": (255, 1, 50), "negate": 1, "resolution": 0.05, "origin": (3.0, -7.0, 0.0)},
    "plain": {"colours": (0, 254, 205), "resolution": 0.1, "origin": (-20.0, 5.0, 0.0), "plain": True},
    "scale": {"png": True, "colours": (0, 255, 0), "mode": "scale", "resolution": 0.25, "origin": (0.5, 0.25, 0.0)},
    "turned": {"png": True, "colours": (10, 250, 205), "resolution": 0.2, "origin": (1.0, 2.0, 2.5)},
}


@pytest.mark.parametrize("kind", MAPS)
def test_five_maps_are_right_side_up(kind, tmp_path):
    """An F whose foot is in the lower left corner of the image has its foot at the origin, for five kinds of file."""
    how = {
        "negate": 0,
        "resolution": 0.5,
        "origin": (-1.0, 2.0, 0.0),
        "mode": "trinary",
        "plain": False,
        "png": False,
        **MAPS[kind],
    }
    drawn = ["####", "#...", "###.", "#..?"]  # the first row is on top
    pixels = np.array([["#.?".index(cell) for cell in row] for row in drawn])
    image = np.array(how["colours"], "u1")[pixels]
    written(tmp_path, image, plain=how["plain"])
    if how["png"]:
        pytest.importorskip("PIL.Image").fromarray(image).save(tmp_path / "map.png")
    x, y, yaw = how["origin"]
    (tmp_path / "nav2.yaml").write_text(
        f"image: map.{'png' if how['png'] else 'pgm'}\nmode: {how['mode']}\n"
        f"resolution: {how['resolution']}\norigin: [{x}, {y}, {yaw}]\n"
        f"negate: {how['negate']}\noccupied_thresh: 0.65\nfree_thresh: 0.19\n"
    )
    scene = Scene.from_map(tmp_path / "nav2.yaml", height=0.5)
    for row in range(4):
        for column in range(4):
            along = how["resolution"] * np.array([column + 0.5, 3.5 - row])
            turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
            assert hits(scene, *(turn @ along + [x, y])) == (drawn[row][column] != "."), (row, column)


def test_a_turned_origin_turns_the_map(tmp_path):
    """The origin's third number turns the map about its lowest corner."""
    pixels = np.full((4, 6), WHITE)
    pixels[3, 5] = BLACK  # from 2.5 to 3 along the image's x, 0 to 0.5 along y
    scene = Scene.from_map(written(tmp_path, pixels, yaw=math.pi / 2), height=0.5)
    assert hits(scene, -1.25, 4.75)
    assert not hits(scene, 1.75, 2.25)


def test_an_origin_in_degrees_causes_a_warning(tmp_path):
    """No map is turned by more than a whole turn."""
    with pytest.warns(UserWarning, match=r"turns the map by 90 rad, more than a whole turn; is this in degrees\?"):
        read_map(written(tmp_path, [[BLACK]], yaw=90.0))


@pytest.mark.parametrize("negate", [0, 1])
def test_thresholds(tmp_path, negate):
    """Dark is occupied, light is free, and grey is unknown, which counts as occupied unless the caller decides else."""
    values = [BLACK, GREY, WHITE]
    pixels = np.array([values if negate == 0 else [255 - v for v in values]])
    path = written(tmp_path, pixels, negate=negate)
    assert [hits(Scene.from_map(path, height=0.5), x, 2.25) for x in (-0.75, -0.25, 0.25)] == [True, True, False]
    open_ones = Scene.from_map(path, height=0.5, unknown=False)
    assert [hits(open_ones, x, 2.25) for x in (-0.75, -0.25, 0.25)] == [True, False, False]


def test_a_threshold_that_frees_unknown_cells_causes_a_warning(tmp_path):
    """ROS writes the grey 205 for unknown cells, which Nav2's usual threshold makes free."""
    path = written(tmp_path, [[BLACK, GREY, WHITE]])
    path.write_text(path.read_text().replace("0.196", "0.25"))
    with pytest.warns(UserWarning, match="makes the grey 205 free"):
        grid = read_map(path)
    assert not grid.unknown.any()


def test_scale_has_no_unknown_cells(tmp_path):
    """In the mode scale, all values that are not free are occupied."""
    path = written(tmp_path, [[BLACK, GREY, WHITE]], more="mode: scale\n")
    grid = read_map(path)
    assert grid.occupied.ravel().tolist() == [True, True, False]
    assert not grid.unknown.any()


def test_an_empty_map_is_an_empty_scene(tmp_path):
    """There is no body without occupied cells."""
    assert len(Scene.from_map(written(tmp_path, [[WHITE]]), height=1.0)) == 0


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 100_000))
def test_rectangles_are_the_cells(seed):
    """They cover each cell once and nothing else."""
    rng = np.random.default_rng(seed)
    cells = rng.uniform(size=rng.integers(1, 12, 2)) < rng.uniform()
    count = np.zeros(cells.shape, int)
    for i0, j0, i1, j1 in rectangles(cells):
        count[i0:i1, j0:j1] += 1
    assert (count == cells).all()


def test_a_wall_is_one_box(tmp_path):
    """Runs that are equal in neighbouring rows become one box."""
    pixels = np.full((50, 60), WHITE)
    pixels[10:14, 5:55] = BLACK
    assert len(Scene.from_map(written(tmp_path, pixels), height=1.0)["map"].pieces) == 1


def test_png_as_pgm(tmp_path):
    """Grey PNG files, and coloured ones that are grey, have the same cells."""
    image = pytest.importorskip("PIL.Image")
    pixels = np.array([[BLACK, WHITE], [GREY, WHITE], [WHITE, BLACK]], "u1")
    wanted = read_map(written(tmp_path, pixels))
    for k, grey in enumerate((image.fromarray(pixels), image.fromarray(np.repeat(pixels[..., None], 3, axis=2)))):
        grey.save(tmp_path / f"{k}.png")
        found = read_map(written(tmp_path, pixels, image=f"{k}.png"))
        assert (found.occupied == wanted.occupied).all()
        assert (found.unknown == wanted.unknown).all()
    coloured = np.repeat(pixels[..., None], 3, axis=2)
    coloured[0, 0, 0] = 99
    image.fromarray(coloured).save(tmp_path / "colour.png")
    (tmp_path / "colour.ppm").write_bytes(b"P6 1 1 255\n\x01\x02\x03")
    for name in ("colour.png", "colour.ppm"):
        with pytest.raises(FileError, match="expected a grey image"):
            read_map(written(tmp_path, pixels, image=name))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (("map.pgm", "none.pgm"), "none.pgm"),
        (("map.pgm", "."), "expected the image of a map, found a directory"),
        (("image: map.pgm\n", ""), "expected the key image"),
        (("[-1.0, 2.0, 0.0]", "[.nan, 2.0, 0.0]"), "origin.*expected a finite number"),
        (("[-1.0, 2.0, 0.0]", "north"), "origin: expected a sequence of 3 .x, y, yaw., found 'north'"),
        (("[-1.0, 2.0, 0.0]", "[1, 2, 0, 0]"), "origin: .* found a sequence of 4"),
        (("resolution: 0.5", "resolution: 0"), "resolution"),
        (("resolution: 0.5", "resolution: .nan"), "resolution"),
        (("resolution: 0.5\n", ""), "resolution"),
        (("[-1.0, 2.0, 0.0]", "[1.0, 2.0]"), "origin"),
        (("negate: 0", "negate: 2"), "negate.*expected 0 or 1, found 2"),
        (("0.65", "1.5"), "occupied_thresh.*from 0 to 1, found 1.5"),
        (("0.196", "0.7"), "free_thresh.*less than occupied_thresh"),
        (("negate", "mode: raw\nnegate"), "mode.*trinary or scale, found 'raw'"),
        (("negate", "cells: 3\nnegate"), "cells"),
    ],
)
def test_odd_files_are_refused(tmp_path, change, text):
    """The error names the file and the key."""
    path = written(tmp_path, [[BLACK]])
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(FileError, match=text):
        Scene.from_map(path, height=1.0)


@pytest.mark.parametrize(
    "data", [b"P5 2 2 255\nabc", b"P5 2 2 0\nabcd", b"P2 2 2 255\n1 2 3 x", b"P2 2 2 9\n1 2 3 10", b"", b"P5 0 2 255\n"]
)
def test_damaged_images_are_refused(tmp_path, data):
    """Too few pixels, values beyond white, and texts that are no image."""
    path = written(tmp_path, [[BLACK]])
    (tmp_path / "map.pgm").write_bytes(data)
    with pytest.raises(FileError, match=r"map.yaml, line 1: image: .*map.pgm: expected [^<]*$"):
        Scene.from_map(path, height=1.0)


def test_the_place_of_a_missing_image_is_named(tmp_path):
    """The name of the image is in the map's file, and the error says where."""
    with pytest.raises(FileError, match=r"map.yaml, line 1: image: .*nope.pgm: expected the image of a map, but there"):
        read_map(written(tmp_path, [[BLACK]], image="nope.pgm"))


def test_heights_are_lengths(tmp_path):
    """The height has to be positive."""
    with pytest.raises(InputError, match="height"):
        Scene.from_map(written(tmp_path, [[BLACK]]), height=0.0)
