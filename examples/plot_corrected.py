"""Look at a corrected record, cell by cell: python examples/plot_corrected.py RECORD.nc FIGURE.png

netCDF4 and matplotlib are in the environment that make run installs. An editor that knows cells runs them in turn.
"""

# %% Open. What could not be corrected is masked already.
import sys

import matplotlib.pyplot as plt
import netCDF4
import numpy as np

record, figure = sys.argv[1:3] if len(sys.argv) > 2 else ("results/EG4/corrected.nc", "eg4.png")
data = netCDF4.Dataset(record)
print(data.title, data.comment, data.history, sep="\n")
day = np.floor(data["TIME"][:].filled()).astype(int)  # since 1950-01-01
days = np.unique(day)

# %% Keep the water: flags 1 and 2 are good; bins above the surface, near the bottom or behind an echo are flagged 4.
# The recorded velocity of the same samples stands beside it, turned by the recorded heading.
pairs = (("UCUR", "VCUR", "corrected", "tab:green"), ("UCUR_RECORDED", "VCUR_RECORDED", "as recorded", "0.6"))
good = np.isin(data["UCUR_QC"][:], [1, 2]) & np.isin(data["VCUR_QC"][:], [1, 2])
kept = {name: np.ma.masked_where(~good, data[name][:]) for pair in pairs for name in pair[:2]}
kept["DEPTH"] = np.ma.masked_where(~good, data["DEPTH"][:])
daily = {name: np.ma.array([values[day == d].mean(axis=0) for d in days]) for name, values in kept.items()}
fullest = int(daily["UCUR"].count(axis=0).argmax())
one = {name: values[:, fullest] for name, values in daily.items()}
depth = f"{float(one['DEPTH'].mean()):.0f} m"
dates = np.datetime64("1950-01-01") + days

# %% Sticks: the daily mean current at one depth, north up. A wrong compass turns them, their lengths stay.
drawn, axes = plt.subplots(3, figsize=(10, 9), layout="constrained", gridspec_kw={"height_ratios": [1, 1, 1.3]})
for axis, (east, north, told, colour) in zip(axes[:2], reversed(pairs), strict=True):
    # angles="uv" draws north upwards whatever the axes; one length a speed in both panels.
    sticks = axis.quiver(
        dates, np.zeros(len(dates)), one[east], one[north], color=colour, angles="uv",
        scale=4.0, width=0.0015, headwidth=0, headlength=0, headaxislength=0,
    )  # fmt: skip
    axis.quiverkey(sticks, 0.9, 0.88, 0.2, "0.2 m/s", labelpos="W")
    axis.set(yticks=[], ylim=(-1, 1), title=f"Daily mean current at {depth}, {told} (north is up)")

# %% The whole column, corrected. DEPTH follows the mooring as it is blown down, so every day has its own depths.
north = daily["VCUR"]
known = ~(np.ma.getmaskarray(north) | np.ma.getmaskarray(daily["DEPTH"]))
speed = float(np.quantile(np.abs(north.compressed()), 0.98)) if known.any() else 1.0
points = axes[2].scatter(
    np.broadcast_to(dates[:, None], known.shape)[known], daily["DEPTH"][known], c=north[known], s=9, marker="s",
    cmap="RdBu_r", vmin=-speed, vmax=speed,
)  # fmt: skip
axes[2].invert_yaxis()
axes[2].set(ylabel="Depth (m)", title="Northward velocity, corrected")
drawn.colorbar(points, ax=axes[2], label="m/s", pad=0.01)
for axis in axes:
    axis.set_xlim(dates[0], dates[-1])
drawn.suptitle(data.title)
drawn.savefig(figure, dpi=110)
