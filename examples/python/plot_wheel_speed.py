"""Plots the speed of a wheel from a log: python plot_wheel_speed.py late.log rover.toml left_wheel speed.svg"""

import sys

import matplotlib.pyplot
import pandas

import cosmic_can

log, cluster, channel, picture = sys.argv[1:]
wheel = pandas.DataFrame(cosmic_can.read_log(log, cluster=cluster, channel=channel))
wheel["time"] -= wheel["time"].iloc[0]
wheel.plot(x="time", y="speed", xlabel="s", ylabel="m/s", title=channel)
matplotlib.pyplot.savefig(picture)
