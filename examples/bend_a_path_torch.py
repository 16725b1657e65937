"""A straight line through obstacles, bent until it is free: PyTorch differentiates the cost and follows.

python examples/bend_a_path_torch.py [--seed 2] [--points 24]

The cost is that of bend_a_path.py, of smooth clearances instead of exact distances: those of all points are one call of
the checker.
"""

import numpy as np
import torch

import loewner
import loewner.torch
from bend_a_path import ARM, KEEP, SCALE, main


def bend_with_torch(straight: np.ndarray, checker: loewner.CollisionChecker) -> tuple[np.ndarray, int]:
    """The points between the ends moved by L-BFGS."""
    clearance, line = loewner.torch.clearance(checker), torch.tensor(straight)
    inner = line[1:-1, ARM].clone().requires_grad_()
    follower = torch.optim.LBFGS([inner], max_iter=500, line_search_fn="strong_wolfe")
    evaluations = 0

    def path() -> torch.Tensor:
        moved = torch.cat([inner, line[1:-1, ARM.stop :]], dim=1)
        return torch.cat([line[:1], moved, line[-1:]])

    def cost() -> torch.Tensor:
        nonlocal evaluations
        evaluations += 1
        follower.zero_grad()
        bent = path()
        lacking = torch.clamp(KEEP - clearance(bent), min=0.0) / SCALE
        total = (bent.diff(dim=0) ** 2).sum() + (lacking**2).sum()
        total.backward()
        return total

    follower.step(cost)
    return path().detach().numpy(), evaluations


if __name__ == "__main__":
    main(bend_with_torch)
