"""The command line: each command has its own file, and `main` combines the commands.

The commands are `fit`, `check`, `clearance`, `robot`, `clash`, `cover`, `judge`, `plan`, `verify`, `audit`, `swept`,
`view`, `compile`, `info`, `paper` and `report`. The commands share `inputs`, `configurations`, `trajectories`, `jobs`
and `output`; `pair_tables`, `cover_tables`, `judge_answers` and `judge_configurations` read and print tables. `drives`
plans for mobile bases, `completion` writes completions for shells, and `compilation` compiles kernels before their
first use.
"""

from loewner.cli.main import main

__all__ = ["main"]
