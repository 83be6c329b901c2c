"""What a training step of the shipped network's widths costs, part by part: randomised pictures, network, network with compiled stages.

    python docs/studies/training_step.py [--batch 64] [--steps 20]

Made-up pictures of 144 × 192, eight of a press; on a GPU where there is one. Left out: choosing and gathering the pictures.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import torch

from learn.augment import draw_look, randomise
from learn.config import configure
from learn.data import Batch
from learn.estimate import pick_device
from learn.model import build, compile_convolutions


def timed(name: str, call: Callable[[], object], steps: int, cuda: bool) -> None:
    """Prints the first call's seconds and the mean milliseconds of `steps` more."""

    def wait() -> float:
        if cuda:
            torch.cuda.synchronize()
        return time.perf_counter()

    start = wait()
    call()
    first = wait()
    for _ in range(steps):
        call()
    print(f"| {name} | {first - start:.1f} | {1e3 * (wait() - first) / steps:.1f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--steps", type=int, default=20)
    options = parser.parse_args()
    config = configure(picture=(144, 192), widths=(48, 96, 192, 320), batch=options.batch, show_background=False)
    device, count, (rows, columns) = pick_device("auto"), options.batch, config.input.picture
    cuda = device.type == "cuda"
    torch.backends.cudnn.deterministic = True
    stack = 255 * torch.rand((count, 1 + config.input.frames, 3, rows, columns), device=device)
    looks = np.stack([draw_look(np.random.default_rng([1, number]), config.augment) for number in range(count)])
    print("| | first [s] | then [ms] |\n|---|---|---|")
    timed("randomised pictures", lambda: randomise(stack, looks, [(1.0, 0.01)] * count, config.augment), options.steps, cuda)

    lengths = torch.full((count,), config.input.frames, device=device)
    target, rigid = 80 * torch.rand(count, device=device), torch.zeros(count, dtype=torch.bool, device=device)
    batch = Batch(stack[:, 1:], stack[:, 0], torch.rand((count, config.input.frames), device=device), lengths, target, rigid,
                  torch.full((count, 3), 17.0, device=device))  # fmt: skip
    for name, prepare in (("network", lambda _: None), ("network, compiled", compile_convolutions)):
        network = build(config).to(device).train()
        prepare(network)
        parts = SimpleNamespace(network=network, optimizer=torch.optim.AdamW(network.parameters(), lr=1e-4))

        def step(parts: SimpleNamespace = parts) -> None:
            with torch.autocast(device.type, dtype=torch.bfloat16, enabled=cuda):
                output = parts.network(batch)
            parts.optimizer.zero_grad(set_to_none=True)
            parts.network.loss(output, batch).backward()
            torch.nn.utils.clip_grad_norm_(parts.network.parameters(), 1.0)
            parts.optimizer.step()

        timed(name, step, options.steps, cuda)


if __name__ == "__main__":
    main()
