"""The kernels that Python calls, each with its name and its one signature.

``entries.NAME`` is the kernel NAME of the native library, if there is one for this machine (`library`). Otherwise,
Numba compiles the kernel when it is first called.

A signature is a sequence of words. A lower-case letter is the type of a number: ``i`` int64, ``f`` float64, ``b`` bool.
An upper-case letter is the type of an array, followed by its number of axes: ``I`` int64, ``F`` float64, ``B`` int8,
``U`` uint8, ``T`` bool. Arrays are in C order; an array marked ``c`` may be read-only.
"""

from importlib import import_module
from typing import Any

from loewner._native import library
from loewner._native.library import Entry
from loewner.errors import MissingExtraError

ENTRIES = {
    entry.name: entry
    for entry in (
        # -- verdicts of pairs, configurations and motions
        Entry("pipeline.verdicts", "settle_range", "i f i i I2 I2 i F3 i F3 B1 I1 i", "b"),
        Entry("pipeline.fallback", "settle_open", "f i i I2 I2 i F3 i F3 B1", ""),
        Entry("pipeline.fallback", "open_triangles", "f i I2 I2 i F3 i F3 I2", "i"),
        Entry("pipeline.fallback", "exact_parts", "i i", "i f F2 F2"),
        Entry("pipeline.workspace", "workspace_size", "", "i"),
        Entry("pipeline.bounds", "estimate_range", "f i i I2 I2 i F3 i F3 B1", ""),
        Entry("robots.configurations", "check_configurations", "i i i F2 i i B1 B1 I1 i", ""),
        Entry("robots.configurations", "check_motion", "F1 F1 F1 i i B1 I1 i", "i i"),
        Entry("robots.configurations", "memory_size", "i i i", "i"),
        Entry("robots.motions", "certify_motions", "i i F3 F2 F1 f i i i B1 F1 I1 I2 i", ""),
        Entry("robots.motions", "free_motions", "i i i F3 i f i i i I2 B1 i", ""),
        Entry("robots.motions", "motion_memory", "i i i", "i"),
        Entry("robots.motion_bounds", "course_bounds", "i i F3 F2 F3", ""),
        Entry("robots.planning", "begin_search", "i F2 i", ""),
        Entry("robots.planning", "connect_trees", "i i", "i"),
        Entry("robots.planning", "path_through", "i F2", "i"),
        Entry("robots.shortening", "shorten_path", "i i I1 F1 F2 I1 F2 F2", "i"),
        Entry("robots.polishing", "polish_path", "i i I1 F1 F2 F2 I1 F1 F2 F2", "i"),
        Entry("robots.nearest", "memory_of_nearest", "i i i", "i"),
        Entry("robots.nearest", "nearest_pairs", "b i i F2 i i i F2 F3 I2 B1", ""),
        Entry("robots.nearest", "near_pairs", "f i i F2 i i i I2 i", "i"),
        Entry("robots.clearances", "memory_of_clearances", "i i i", "i"),
        Entry("robots.clearances", "clearances", "b f i i F2 i i i F1 F2", ""),
        Entry("robots.clearances", "pair_gradients", "i i F2 i i i cI2 cF2 cF2 F2", ""),
        Entry("robots.kinematics", "link_poses", "I1 I1 I1 F1 F1 F2 F2 i i F4", ""),
        Entry("robots.brakes", "brakes_by_joint", "F2 F2 F2 F1 F1 F2 F4 I1", ""),
        Entry("robots.brakes", "brakes_on_path", "F2 F1 F1 F1 F1 b F2 F4 I1 I1", ""),
        Entry("robots.brakes", "courses_of_brakes", "F2 F4 I1 F3 F1", "i"),
        Entry("robots.brakes", "whole_brakes", "F2 F4 I1 F1 F3 F2", ""),
        Entry("robots.pose_paths", "pose_values", "I1 F1 F2 F1 F1 F1 F3", ""),
        Entry("robots.reach", "reach_poses", "I2 F2 F2 F1 F3 F2 F2 i i i F3 I1 F2", ""),
        Entry("robots.lines", "follow_line", "I2 F2 F2 F1 F2 F1", "i F2"),
        Entry("robots.lines", "keep_axis", "i F2 F2 T1", ""),
        Entry("robots.wrenches", "link_jacobians", "I1 I1 I1 F1 F1 F2 F2 i i i F1 F3", ""),
        Entry("robots.plane_trees", "measure_model", "i", ""),
        Entry("robots.plane_trees", "plane_trees", "i i F2 F2 f F2 U1 F2", "i i i f f"),
        Entry("robots.pair_lists", "list_pairs", "I1 I1 I1 I2 F2 F1 I2 F1 I2 F1", "i"),
        Entry("robots.pair_lists", "lay_out", "i i F1 F1", "i i i"),
        Entry("robots.standing", "place_static", "i i F1 F2", "i"),
        # -- distances
        Entry("pipeline.distances", "distance_range", "b i i I2 I2 i F3 i F3 i F2 F3 B1", "I2 F2"),
        Entry("pipeline.distances", "memory_of_distances", "", "i"),
        Entry("pipeline.distances", "measure_left", "I2 F2 i F3 i F3 F2 F3 B1", ""),
        Entry("pipeline.first_contacts", "first_contacts", "i i I2 i F3 F3 i F3 F3 f f i F2 B1", "i i"),
        Entry("pipeline.first_contacts", "memory_of_first_contacts", "", "i"),
        # -- points and meshes
        Entry("narrow.mesh_points", "points_memory", "", "i"),
        Entry("narrow.mesh_points", "squared_distances_of", "cF2 cF3 F1", ""),
        Entry("narrow.mesh_points", "heights_above", "F1 F2 F1 F1", ""),
        Entry("narrow.mesh_points", "nearest_triangles", "i f cF2 F1 I1 i", ""),
        Entry("narrow.mesh_points", "winding_numbers", "i f cF2 I1 i", ""),
        Entry("narrow.mesh_points", "facing_one_way", "i f cF2 cF1 cF2 b f i T1 F2 i", ""),
        Entry("narrow.inscribed", "inscribed_ellipsoids", "i f f F1 f F2 F3 i", "i"),
        # -- ellipsoids
        Entry("ellipsoids.contact_robust", "contact_of_pairs", "F2 F3 F3 F1", ""),
        Entry("ellipsoids.near_points", "near_points_of_pairs", "i F2 F3 F3 f F2 F2 F1 I1 I1", ""),
        # -- elementary functions, even points
        Entry("elementary", "elementary", "i F1 F1 F1", ""),
        Entry("low_discrepancy", "irrationals", "F1 F1", ""),
        # -- poses, crowds, trees
        Entry("pieces.rigid", "first_fault", "F3", "i i f"),
        Entry("pieces.joining", "join_bodies", "I2 F1", "i"),
        Entry("pieces.directions", "direction_map", "F2", "I1 F2"),
        Entry("trees.piece_tree", "piece_trees", "cI1 cF2 cF2", "F1 I1 I1"),
        Entry("trees.triangle_tree", "triangle_tree", "cF2 cI2", "F1 I1 F1 F1 F1 I1"),
        Entry("trees.cuts", "cut_up", "F1 I1 f i I1 I1 F2 F2 F3", "i"),
        Entry("trees.triangle_mesh", "equal_vertices", "cF2", "i I1"),
        Entry("trees.triangle_mesh", "part_vertices", "i cI2", "I1"),
        Entry("trees.boxes", "body_boxes", "i i i i i F3 F2 F2", ""),
        Entry("trees.boxes", "curve_order", "F2 F2", "I1"),
        Entry("trees.boxes", "box_tree", "F2 F2 I1", "F1 I1"),
        Entry("trees.boxes", "meeting_boxes", "i i f F1 I1 I1 I1 I1", "i i"),
        # -- fits
        Entry("fits.pieces", "fit_range", "i i I1 F2 I1 F2 f f F2 F3 F2 F3 F2", ""),
        Entry("fits.halfspaces", "center_in", "F2 F1 F1 F2 F1 f", "i"),
        Entry("fits.halfspaces", "fit_halfspaces", "F2 F1 F1 f f F1 F2 F1", "i f i"),
        Entry("fits.hulls", "to_unit_size", "F2 f", "i i f f F1 F2 F2"),
        Entry("fits.hulls", "finish_hull", "F2 F2 F2 I2 I2 F2", "i f T1 I1 F2 F1"),
        Entry("fits.many", "mark_beyond", "i i F2 F1 F2 F1 f T1", ""),
        Entry("fits.mvce", "fit_outer", "F2 f f F1 F2", "i f i i f f"),
        Entry("fits.mvce", "enclose", "F2 F1 F2", "f"),
        Entry("fits.mvce", "outer_gap", "F2 I1 F1 i F1 F2 f", "f"),
        Entry("fits.coverings", "find_held", "i F2 F1 I2 I2", ""),
        Entry("fits.coverings", "choose_few", "i i I1 I2 I2 I1", "i"),
        Entry("fits.mvie", "solve_primal_dual", "F2 i i f F1 F2 F1", "f i"),
        # -- the paper
        Entry("paper.detectors", "detector_1", "F3 F4 F2 I1 F2 I1 U1 U1", ""),
        Entry("paper.detectors", "detector_2", "F3 F4 f U1 U1", ""),
        Entry("paper.detectors", "detector_3", "F3 F4 U1 U1", ""),
        Entry("paper.detectors", "detector_4", "F3 F4 U1 U1", ""),
        Entry("paper.estimates", "estimates_of_pairs", "i F3 F4 F1", ""),
    )
}


def __getattr__(name: str) -> Any:
    """Look up a kernel at its first use, after which it is an ordinary name of this module."""
    if name not in ENTRIES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    kernel = library.kernel(ENTRIES[name]) or _compiled(ENTRIES[name])
    globals()[name] = kernel
    return kernel


def _compiled(entry: Entry) -> Any:
    """Return the kernel that Numba compiles on this machine."""
    expect_numba()
    return getattr(import_module(f"loewner._kernels.{entry.module}"), entry.name)


def expect_numba() -> None:
    """Raise an error if there is neither a native library nor Numba."""
    try:
        import numba  # noqa: F401
    except ImportError:
        raise MissingExtraError(
            f"expected loewner's native library, or Numba to compile its kernels; found no library to use "
            f"({library.why_not()}) and no Numba: pip install 'loewner[jit]', or install loewner again"
        ) from None


def signatures(entry: Entry) -> list[tuple[Any, ...]]:
    """Return Numba's types of an entry's arguments: with read-only arrays where they are allowed, and without them."""
    words = entry.arguments
    return [types_of(text) for text in dict.fromkeys([words, words.replace("c", "")])]


def types_of(words: str) -> tuple[Any, ...]:
    """Return Numba's types for the words of a signature."""
    from numba import types

    numbers = {"i": types.int64, "f": types.float64, "b": types.boolean}
    kinds = {"F": types.float64, "I": types.int64, "B": types.int8, "U": types.uint8, "T": types.boolean}

    def type_of(word: str) -> Any:
        if word in numbers:
            return numbers[word]
        text = word.removeprefix("c")
        return types.Array(kinds[text[0]], int(text[1:]), "C", readonly=word.startswith("c"))

    return tuple(map(type_of, words.split()))


def missing() -> list[str]:
    """Return the names of the kernels that the library in use lacks, because its build goes on or has ended early."""
    return [name for name, entry in ENTRIES.items() if library.is_missing(entry)]
