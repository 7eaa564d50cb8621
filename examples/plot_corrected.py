"""Look at a corrected record with xarray, cell by cell: python examples/plot_corrected.py RECORD.nc FIGURE.png

xarray is in the test environment (make test installs it). An editor that knows cells runs them one at a time.
"""

# %% Open. Times are decoded by xarray; what could not be corrected is missing already.
import sys

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

record, figure = sys.argv[1:3] if len(sys.argv) > 2 else ("results/EG4/corrected.nc", "eg4.png")
data = xr.open_dataset(record)
print(data.title, data.comment, data.history, sep="\n")

# %% Keep the water: flags 1 and 2 are good; bins above the surface, near the bottom or behind an echo are flagged 4.
# The recorded velocity of the same samples stands beside it, turned by the recorded heading.
pairs = (("UCUR", "VCUR", "corrected", "tab:green"), ("UCUR_RECORDED", "VCUR_RECORDED", "as recorded", "0.6"))
data = data.reset_coords("DEPTH")
good = data.UCUR_QC.isin([1, 2]) & data.VCUR_QC.isin([1, 2])
names = ["UCUR", "VCUR", "UCUR_RECORDED", "VCUR_RECORDED", "DEPTH"]
daily = data[names].where(good).resample(TIME="1D").mean()
fullest = int(daily.UCUR.notnull().sum("TIME").argmax("BIN"))
one = daily.isel(BIN=fullest)
depth = f"{float(one.DEPTH.mean()):.0f} m"

# %% Sticks: the daily mean current at one depth, north up. A wrong compass turns them, their lengths stay.
drawn, axes = plt.subplots(3, figsize=(10, 9), layout="constrained", gridspec_kw={"height_ratios": [1, 1, 1.3]})
for axis, (east, north, told, colour) in zip(axes[:2], reversed(pairs), strict=True):
    # angles="uv" draws north upwards whatever the axes; one length a speed in both panels.
    sticks = axis.quiver(
        one.TIME, np.zeros(one.sizes["TIME"]), one[east], one[north], color=colour, angles="uv",
        scale=4.0, width=0.0015, headwidth=0, headlength=0, headaxislength=0,
    )  # fmt: skip
    axis.quiverkey(sticks, 0.9, 0.88, 0.2, "0.2 m/s", labelpos="W")
    axis.set(yticks=[], ylim=(-1, 1), title=f"Daily mean current at {depth}, {told} (north is up)")

# %% The whole column, corrected. DEPTH follows the mooring as it is blown down, so every day has its own depths.
days = np.broadcast_to(daily.TIME.values[:, None], daily.DEPTH.shape)
known = daily.DEPTH.notnull() & daily.VCUR.notnull()
speed = float(abs(daily.VCUR).quantile(0.98))
points = axes[2].scatter(
    days[known], daily.DEPTH.values[known], c=daily.VCUR.values[known], s=9, marker="s", cmap="RdBu_r",
    vmin=-speed, vmax=speed,
)  # fmt: skip
axes[2].invert_yaxis()
axes[2].set(ylabel="Depth (m)", title="Northward velocity, corrected")
drawn.colorbar(points, ax=axes[2], label="m/s", pad=0.01)
limits = (daily.TIME.values[0], daily.TIME.values[-1])
for axis in axes:
    axis.set_xlim(*limits)
drawn.suptitle(data.title)
drawn.savefig(figure, dpi=110)
