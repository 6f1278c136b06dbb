"""The program that has every kernel compiled, for an environment in which nothing is to wait for it later."""

COMPILE = """\
from camrig import detect, locate
from camrig.optimise import PlannerSettings, warm_up
detect.warm_up()
locate.warm_up()
warm_up(PlannerSettings(visibility="image"))
"""
