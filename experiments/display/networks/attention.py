"""Figure of channel attention: the weights of each layer, and the surface that they point to."""

import numpy as np

from cablejax.report import line_styles
from experiments.analysis.results import Results
from experiments.display.drawing import Drawing, new_figure


def surface(results: Results) -> Drawing:
    """Weights of the channels, and their mean at each point of the unrolled surface, for three sizes."""
    clouds = results.clouds
    layers = len(clouds[0]["channels"])
    figure = new_figure(6.8, 1.8 + 1.55 * len(clouds))
    axes = figure.subplots(1 + len(clouds), layers)
    for ax, layer in zip(axes[0], range(layers), strict=True):
        for style, cloud in zip(line_styles(), clouds, strict=False):
            weights = np.sort(cloud["channels"][layer])[::-1]
            rank = 100 * (np.arange(len(weights)) + 0.5) / len(weights)
            ax.plot(rank, weights, label=f"{cloud['size_mm2']:g} mm²", **style)
        ax.set_ylim(0, 1)
        ax.set_title(f"layer {layer + 1}", loc="left", fontsize=10)
        ax.set_xlabel("channels (%)", fontsize=9)
    axes[0, 0].set_ylabel("weight, eq. (12)", fontsize=9)
    for layer in range(layers):
        _surfaces(figure, axes[1:, layer], clouds, layer)
    for ax in axes[:, 1:].ravel():
        ax.set_yticklabels([])
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=len(clouds), fontsize=9)
    return Drawing(
        "attention",
        figure,
        "Channel attention of each layer: sorted weights, and their mean at each point of the unrolled surface of three cables.",
        f"Attention of a trained ADGCNN ({_told(results)}) on three test cables. Top: the weights of equation (12), sorted, each "
        "of a channel, not of a point. Below: each cable unrolled; colour is the mean weight of the channels, each "
        "counted by its response at the point, on a scale of its own for each layer.",
    )


def _told(results: Results) -> str:
    run, config = results.trained_by, results.shared
    return f"of `{run}`, size {results.size}, {config['optimizer.name']}, {config['training.epochs']} epochs"


def _surfaces(figure, axes, clouds: list[dict], layer: int) -> None:
    """One layer's column: a cable in each row, one colour scale."""
    values = np.concatenate([cloud["points"][layer] for cloud in clouds])
    low, high = np.percentile(values, [2, 98])
    reach = 1.05 * max(np.abs(cloud["along_mm"]).max() for cloud in clouds)
    drawn = None
    for ax, cloud in zip(axes, clouds, strict=True):
        drawn = ax.scatter(
            cloud["along_mm"], cloud["angle_deg"], c=cloud["points"][layer], s=5, cmap="viridis", vmin=low, vmax=high
        )
        ax.set_ylim(-180, 180)
        ax.set_yticks([-180, 0, 180])
        ax.set_xlim(-reach, reach)
        if layer == 0:
            ax.set_ylabel(f"{cloud['size_mm2']:g} mm²\nangle (degrees)", fontsize=9)
    axes[-1].set_xlabel("along (mm)", fontsize=9)
    assert drawn is not None
    bar = figure.colorbar(drawn, ax=list(axes), orientation="horizontal", aspect=14, pad=0.02)
    bar.ax.tick_params(labelsize=8)
    bar.ax.locator_params(nbins=3)
    bar.set_label("mean weight", fontsize=9)
