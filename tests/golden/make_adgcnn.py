"""Make adgcnn.npz: a small ADGCNN in PyTorch, its inputs, weights, outputs and gradients: `python -m tests.golden.make_adgcnn`.

Needs torch (docs/dependencies.md). Computed in float64 from inputs and weights that are exact in float32, and stored in
float32; the test then allows for the rounding of one side alone.
"""

from pathlib import Path

import numpy as np

PATH = Path(__file__).with_name("adgcnn.npz")
CLOUDS, POINTS, CLASSES = 3, 48, 5


def posed_clouds(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Points on half-cylinders of three sizes, as `cablejax.nets.pose_clouds` gives them."""
    angle = np.radians(rng.uniform(-90, 90, (CLOUDS, POINTS)))
    radius = np.array([[0.5], [0.7], [1.0]]) + rng.normal(0, 0.01, angle.shape)
    axial = rng.uniform(-2.5, 2.5, angle.shape)
    features = np.stack([axial, radius * np.cos(angle), radius * np.sin(angle), radius], axis=2)
    return {"features": features, "axial": axial, "angle": angle, "radius": radius}


def main() -> None:
    """Run the network in training and in evaluation mode and store everything."""
    import torch  # here, so that collecting the tests does without

    from benchmarks import torch_nets

    rng = np.random.default_rng(0)
    torch.set_default_dtype(torch.float64)
    torch.manual_seed(0)
    model = torch_nets.ADGCNN(
        CLASSES, k=6, widths=(8, 8, 8, 16), raster_shape=(4, 8), raster_width=8, shared=16, head=(16, 8)
    )
    stored: dict[str, np.ndarray] = {}
    with torch.no_grad():
        for name, value in model.named_parameters():
            if name.endswith((".scale", ".bias")):  # both signs: a negative scale turns the maximum into a minimum
                value += 0.5 * torch.randn_like(value)
            if name.endswith(".scale"):
                value *= torch.where(torch.rand_like(value) < 0.25, -1.0, 1.0)
            value.copy_(value.float())
            stored[f"weight/{name}"] = value.numpy().copy()
    inputs = {name: value.astype(np.float32) for name, value in posed_clouds(rng).items()}
    cotangent = rng.normal(size=(CLOUDS, CLASSES)).astype(np.float32)
    stored |= {f"input/{name}": value for name, value in inputs.items()} | {"cotangent": cotangent}
    posed = {name: torch.from_numpy(value).double() for name, value in inputs.items()}
    posed["features"].requires_grad_()
    logits = model(**posed)
    (logits * torch.from_numpy(cotangent)).sum().backward()
    stored["logits_train"] = logits.detach().numpy()
    stored["gradient_input"] = posed["features"].grad.numpy()
    stored |= {f"gradient/{name}": value.grad.numpy() for name, value in model.named_parameters()}
    stored |= {f"statistic/{name}": value.numpy().copy() for name, value in model.named_buffers()}
    model.eval()
    stored["logits_eval"] = model(**posed).detach().numpy()
    np.savez_compressed(PATH, **{name: np.asarray(value, np.float32) for name, value in stored.items()})


if __name__ == "__main__":
    main()
