"""The integrals that fill an atmosphere's tables, one file for each stage.

Each stage has a `compute_*` function, which takes any rays and reads like the formula, and a `build_*` function, which fills the whole
table with the same numbers. `precompute/atmosphere_tables.py` runs them in their order.
"""
