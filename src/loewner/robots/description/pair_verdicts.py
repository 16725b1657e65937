"""Hold the verdicts on whether pairs of bodies can ever collide, and write them as SRDF rules."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from loewner._base import _validate
from loewner._base._files import read_regular, write_atomically
from loewner._base._validate import Floats, Pair
from loewner.errors import FileError, InputError, UnknownNameError
from loewner.robots.description.xml_elements import MOST_BYTES, read_xml
from loewner.scenes.scene import Scene


class PairVerdict(StrEnum):
    """Whether a pair can collide at any configuration of a range."""

    NEVER = "NEVER"
    ALWAYS = "ALWAYS"
    SOMETIMES = "SOMETIMES"
    CAN = "CAN"
    OPEN = "OPEN"


class Terms(NamedTuple):
    """The arguments that `Robot.prove_pairs` and `Robot.free_range` have in common.

    Attributes
    ----------
    margin, limits, scene, boxes
        See `Robot.prove_pairs`.
    only_free : bool
        Omit the least distances of pairs whose verdict is not NEVER.
    """

    margin: float
    limits: Mapping[str, tuple[float, float]] | None
    scene: Scene | None
    boxes: int
    only_free: bool = False


# For each verdict that exempts a pair, the reason in the words of MoveIt's setup assistant.
REASONS = {PairVerdict.NEVER: "Never", PairVerdict.ALWAYS: "Always"}


@dataclass(frozen=True, eq=False, repr=False)
class ProvenPair(_validate.Brief):
    """An answer about one pair, over ranges of the joints between its bodies.

    Attributes
    ----------
    names : tuple of str
    verdict : str
        NEVER: the bodies are proven to be farther apart than the margin at every configuration of the range. ALWAYS:
        the bodies are proven to be within the margin at every configuration of the range. SOMETIMES: the bodies are
        within the margin at ``colliding``, but not at ``free``. CAN: the bodies are within the margin at ``colliding``,
        and no configuration without contact was found. OPEN: no contact was found, and a part of the range could not be
        proven free of contact; see ``reason``.
    columns : tuple of str
        The values on which the pair depends, named as in `Robot.configuration_names`.
    lower, upper : ndarray, shape (columns,)
        The ranges of the values, in radians or metres.
    margin : float
        Distance in metres that counts as contact.
    distance : float
        The least signed distance that was found [m]; a negative value is a depth. NaN if no distance could be computed.
    nearest : ndarray, shape (dof,), or None
        A configuration at which the bodies have this distance; values on which the pair does not depend are as in
        `Robot.configuration`.
    colliding, free : ndarray, shape (dof,), or None
        At ``colliding``, the bodies are within the margin, as `CollisionChecker.collide` confirms. At ``free``, the
        bodies are not within the margin.
    boxes : int
        The number of boxes of configurations that were examined.
    share : float
        The share of the range that is proven.
    complete : bool
        Whether the range covers all values between the hard limits of the robot.
    reason : str
        The reason why the pair is OPEN or CAN; empty for other verdicts.
    """

    names: Pair
    verdict: PairVerdict
    columns: tuple[str, ...]
    lower: Floats
    upper: Floats
    margin: float = 0.0
    distance: float = np.nan
    nearest: Floats | None = None
    colliding: Floats | None = None
    free: Floats | None = None
    boxes: int = 0
    share: float = 0.0
    complete: bool = True
    reason: str = ""

    @property
    def range_text(self) -> str:
        """The range as text: "elbow 0 .. 1.5, rail 0 .. 2"."""
        ends = zip(self.columns, self.lower.tolist(), self.upper.tolist(), strict=True)
        return ", ".join(f"{name} {low:.6g} .. {high:.6g}" for name, low, high in ends)


@dataclass(frozen=True, eq=False)
class ProvenPairs:
    """Answers about which pairs of bodies can ever collide, as a sequence of `ProvenPair`.

    Attributes
    ----------
    robot : str
        Name of the robot.
    rows : tuple of ProvenPair
        One row per pair, sorted by names.
    rigid : tuple of pairs of str
        The requested pairs whose bodies are on the same rigid part of the robot. Such pairs are never checked. If a
        link and a body of the scene have no joint between them, their pair has a row with an empty range instead.
    proof : Proof or None
        A proof of all rows, if all are NEVER, for other programs to verify; None if no proof was requested.

    Examples
    --------
    >>> from loewner import Robot
    >>> found = Robot.from_urdf("arm.urdf").prove_pairs([("rail", "forearm"), ("rail", "cart")])
    >>> [(row.names, str(row.verdict)) for row in found]
    [(('cart', 'rail'), 'NEVER'), (('forearm', 'rail'), 'NEVER')]
    """

    robot: str
    rows: tuple[ProvenPair, ...]
    rigid: tuple[Pair, ...] = ()
    proof: Any = None

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[ProvenPair]:
        return iter(self.rows)

    def __getitem__(self, pair: int | Pair) -> ProvenPair:
        """Return a row by its number, or by the names of its pair in any order."""
        if isinstance(pair, (int, np.integer)):
            return self.rows[pair]
        for row in self.rows:
            if set(row.names) == set(pair):
                return row
        raise UnknownNameError(f"expected a pair among the {len(self.rows)} rows, found {_validate.short(pair)}")

    def __repr__(self) -> str:
        counts = ", ".join(f"{len(self.with_verdict(kind))} {kind}" for kind in PairVerdict if self.with_verdict(kind))
        return f"ProvenPairs({self.robot!r}, {len(self.rows)} pairs: {counts or 'none'})"

    def _repr_html_(self) -> str:
        from html import escape

        head = "".join(f"<th>{title}</th>" for title in ("pair", "verdict", "least distance [mm]", "range", "reason"))
        lines = []
        for row in self.rows:
            distance = "" if np.isnan(row.distance) else f"{1e3 * row.distance:.3f}"
            cells = (" – ".join(row.names), str(row.verdict), distance, row.range_text, row.reason)
            lines.append("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>")
        return f"<table><tr>{head}</tr>{''.join(lines)}</table>"

    def with_verdict(self, *verdicts: PairVerdict | str) -> tuple[ProvenPair, ...]:
        """Return the rows with one of the given verdicts."""
        wanted = {PairVerdict(verdict) for verdict in verdicts}
        return tuple(row for row in self.rows if row.verdict in wanted)

    @property
    def exempt(self) -> frozenset[Pair]:
        """The pairs that are proven never to collide or always to collide, for `Robot.disabling`.

        Pairs without a joint between them are left out.
        """
        return frozenset(row.names for row in self.with_verdict(*REASONS) if row.columns)

    def to_srdf(self, path: str | os.PathLike[str], *, narrower: bool = False) -> tuple[Pair, ...]:
        """Add the proven pairs to an SRDF, as pairs that are exempt from checking.

        A pair that is proven never to collide gets the reason "Never", and a pair that always collides gets the reason
        "Always". A comment gives the range of each proof. Pairs without a joint between them are left out. The existing
        contents of the file stay unchanged.

        Parameters
        ----------
        path : path
            An SRDF of this robot, or a new file.
        narrower : bool
            Also write pairs that are proven for a range narrower than the hard limits of the robot.

        Returns
        -------
        tuple of pairs of str
            The pairs that were written. Pairs that are already in the file are not written again.

        Raises
        ------
        InputError
            If a proven range is narrower than the hard limits, unless `narrower` is true. If the margin is not 0 and a
            pair is ALWAYS within it, since bodies within a margin need not be in contact.
        FileError
            If the file is not an SRDF of this robot, or cannot be read or written.
        """
        target = _validate.path(path, "path", wanted="the path of an SRDF")
        rows = [row for row in self.with_verdict(*REASONS) if row.columns]
        for row in rows:
            if not row.complete and not _validate.flag(narrower, "narrower"):
                raise InputError(
                    f"expected proofs over the hard limits of the joints, found {row.verdict} of "
                    f"{' and '.join(row.names)} over {row.range_text}; narrower=True writes it nevertheless"
                )
            if row.verdict is PairVerdict.ALWAYS and row.margin > 0:
                raise InputError(
                    f"expected proofs without a margin, found that {' and '.join(row.names)} are always within "
                    f"{row.margin:g} m, which is no contact"
                )
        before, listed_pairs = _srdf(target, self.robot)
        new = [row for row in rows if frozenset(row.names) not in listed_pairs]
        lines = "".join(
            f"  <disable_collisions link1={quoteattr(row.names[0])} link2={quoteattr(row.names[1])} "
            f'reason="{REASONS[row.verdict]}"/>  <!-- proven: {row.range_text.replace("--", "- -")} -->\n'
            for row in new
        )
        # Find the last end tag outside comments.
        at = re.sub(r"<!--.*?-->", lambda comment: " " * len(comment[0]), before, flags=re.DOTALL).rindex("</robot")
        after = before[:at] + lines.replace("\n", "\r\n" if "\r\n" in before else "\n") + before[at:]
        if not {frozenset(row.names) for row in new} <= _listed(target, after):
            raise FileError(f"{target}: expected an SRDF that ends in </robot>, found another end")
        write_atomically(target, after.encode())
        return tuple(row.names for row in new)


def _srdf(path: Path, robot: str) -> tuple[str, set[frozenset[str]]]:
    """Return the text of an SRDF, or of a new SRDF if there is none, and the pairs that it lists."""
    if not path.exists():
        return f'<?xml version="1.0"?>\n<robot name={quoteattr(robot)}>\n</robot>\n', set()
    root, data = read_xml(path, "an SRDF"), read_regular(path, "an SRDF", MOST_BYTES)
    name = root.attributes.get("name", "")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: expected an SRDF in UTF-8, found another encoding ({error})") from None
    if name != robot or "</robot" not in text:
        raise FileError(f"{path}: expected an SRDF of the robot {robot!r} that ends in </robot>, found one of {name!r}")
    return text, _listed(path, text)


def _listed(path: Path, text: str) -> set[frozenset[str]]:
    """Return all pairs in the text of an SRDF: pairs that are exempt from checking, and pairs to check."""
    root = read_xml(path, "an SRDF", text.removeprefix("\ufeff"))
    elements = [*root.all("disable_collisions"), *root.all("enable_collisions")]
    return {frozenset((one.attributes.get("link1", ""), one.attributes.get("link2", ""))) for one in elements}
