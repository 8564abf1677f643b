"""An assessment from Python: rate a car, compute its figures anew from its episodes, and draw them."""

import sys

import matplotlib.pyplot as plt
from skd_evaluator import assess, clustered_mean, deviation, load_result


def main(out: str) -> None:
    """Assess the basic car into a folder that is not there yet, and draw a picture beside the results."""
    rating = assess("basic", multiplier=1.0, objective="deviation", safe_count=5, kamikaze_count=20, seed=0, out=out)
    print(f"margin {rating.as_dict()['margin']:.3f} m, found in {rating.seconds:.1f} s")
    result = load_result(out)  # refused where its figures do not follow from its episodes
    mean = clustered_mean(result.groups["margin"])
    print(f"margin again {mean.value:.3f} m, the mean of {mean.values} trials along {mean.groups} safe trajectories")
    deviations = [
        deviation(phi.positions, log.trajectory.positions, log.impact_time / phi.time_step)
        for log in rating.kamikaze_logs
        if log.hit and (phi := log.episode.safe_trajectory)
    ]
    print(f"{len(deviations)} kamikazes were hit, {sum(deviations) / len(deviations):.3f} m from φ on average")
    figure, axes = plt.subplots()
    for number, margins in enumerate(result.groups["margin"], start=1):
        axes.plot([number] * len(margins), margins, ".", alpha=0.5)
    axes.set(xlabel="safe trajectory φ", ylabel="margin of a trial (m)", title="Margins of the basic car")
    figure.savefig(f"{out}/margins.png", dpi=150)


if __name__ == "__main__":
    main(*sys.argv[1:] or ["skd_results/library"])
