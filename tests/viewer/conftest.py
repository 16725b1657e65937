"""A browser, a robot and a scene for the tests of the viewer."""

import pytest

from browsers import chromium, missing
from families import translation
from loewner import Body, CollisionChecker, Robot, Scene
from viewer_pages import PATIENCE, WINDOW

# Chromium as root in a container, with no network and no graphics card.
FLAGS = ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"]
FLAGS += ["--disable-component-update", "--disable-sync"]
# Names that a foreign site could have, made to point here.
FLAGS += ["--host-resolver-rules=MAP *.example 127.0.0.1"]
# Software draws the scenes; panels are drawn without its OpenGL, which saves a quarter of the time.
FLAGS += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
FLAGS += ["--disable-gpu-rasterization"]

ARM = """
<robot name="arm">
  <link name="base"><collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
  <link name="upper"><collision><origin xyz="0 0 0.5"/><geometry><box size="0.1 0.1 0.6"/></geometry></collision></link>
  <link name="fore"><collision><origin xyz="0 0 0.5"/><geometry><box size="0.1 0.1 0.6"/></geometry></collision></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.9"/>
    <axis xyz="0 1 0"/></joint>
</robot>
"""


@pytest.fixture(autouse=True)
def viser():
    try:
        import viser
    except ImportError:
        missing("no viser: pip install -r requirements/dev.txt")
    return viser


@pytest.fixture(scope="module")
def browser():
    with chromium(args=FLAGS) as browser:
        yield browser


@pytest.fixture
def tab(browser):
    """An empty page of the browser that notes where it asks for anything."""
    tab = browser.new_page(viewport=WINDOW)
    tab.set_default_timeout(PATIENCE)
    tab.asked = []
    tab.on("request", lambda request: tab.asked.append(request.url))
    yield tab
    tab.close()


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    scene = Scene()
    scene.add("wall/left", Body.box([0.1, 1, 1]), translation(1.2))
    scene.add("<b>ball</b>", Body.sphere(0.2), translation(-1.2))
    return CollisionChecker(Robot.from_urdf(path), scene)


@pytest.fixture
def lonely(tmp_path):
    """A robot of one link."""
    path = tmp_path / "lonely.urdf"
    box = '<collision><geometry><box size="1 1 1"/></geometry></collision>'
    path.write_text(f'<robot name="lonely"><link name="base">{box}</link></robot>')
    return Robot.from_urdf(path)
