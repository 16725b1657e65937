"""What MuJoCo says of a model: where its bodies are, and which of its geoms touch."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from loewner import CollisionChecker, Robot, distance

# Nearer to touching than this [m], MuJoCo's searches and ours may disagree: its tolerance for convex pairs is 1e-6.
TOUCHING = 2e-6


def compiled(path: Path) -> mujoco.MjModel:
    """The model without margins and with collisions, whatever its options say."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.geom_margin[:] = 0
    model.pair_margin[:] = 0
    switches = mujoco.mjtDisableBit
    model.opt.disableflags &= ~(switches.mjDSBL_CONTACT | switches.mjDSBL_CONSTRAINT)
    return model


def links_of_geoms(model: mujoco.MjModel) -> dict[int, str]:
    """For each geom the name that its link should have: its own in the world, else its body's, or both.

    Geoms of a body share a link with the first one of the same masks. The first such link has the body's name, another
    one that of its first geom besides. A geom in the world that has the name of a body is called so.
    """
    paired = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
    found: dict[int, str] = {}
    firsts: dict[tuple[int, ...], int] = {}
    bodies, names = set(), {model.body(body).name for body in range(model.nbody)}
    for geom in range(model.ngeom):
        body, masks = int(model.geom_bodyid[geom]), (model.geom_contype[geom], model.geom_conaffinity[geom])
        if not any(masks) and geom not in paired:
            continue
        of_body, own = model.body(body).name or f"body{body}", model.geom(geom).name or f"geom{geom}"
        first = firsts.setdefault((body, *masks, geom if body == 0 or geom in paired else -1), geom)
        if first != geom:
            found[geom] = found[first]
        else:
            own += "_geom" * (body == 0 and own in names)
            found[geom] = own if body == 0 else f"{of_body}/{own}" if body in bodies else of_body
            bodies.add(body)
    return found


def compare(robot: Robot, path: Path, Q: np.ndarray) -> dict[str, float]:
    """How far poses are apart; how many contacts both find, and how many either alone, touching or not.

    Contacts are pairs of links.
    """
    model = compiled(path)
    data = mujoco.MjData(model)
    Ts = robot.forward_kinematics(Q)
    rows = [robot.link_names.index(model.body(b).name or f"body{b}") for b in range(model.nbody)]
    checker, link = CollisionChecker(robot), links_of_geoms(model)
    told = {"off": 0.0, "both": 0, "near": 0, "ours": 0, "theirs": 0}
    for q, T in zip(Q, Ts, strict=True):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        told["off"] = max(told["off"], np.abs(T[rows, :3, 3] - data.xpos).max())
        told["off"] = max(told["off"], np.abs(T[rows, :3, :3].reshape(-1, 9) - data.xmat).max())
        contacts = (data.contact[k] for k in range(data.ncon))
        theirs = {tuple(sorted((link[c.geom1], link[c.geom2]))) for c in contacts if c.dist <= 0}
        ours = {tuple(sorted((c.name_a, c.name_b))) for c in checker.pairs(q)}
        told["both"] += len(ours & theirs)
        for a, b in ours ^ theirs:
            T_a, T_b = (T[robot.link_names.index(name)] for name in (a, b))
            apart = distance(robot.bodies[a], T_a, robot.bodies[b], T_b, exact=True).distance
            told["near" if abs(apart) < TOUCHING else "ours" if (a, b) in ours else "theirs"] += 1
    return told
