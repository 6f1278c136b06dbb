"""The planner's inner loops, compiled by numba: poses, sights, tables, descent. Pure; arrays in, arrays out."""
