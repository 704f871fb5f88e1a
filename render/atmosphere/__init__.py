"""The air of a planet lit by its sun: parameters, ray geometry, tables of scattered light and how they are looked up.

The model is that of Bruneton & Neyret 2008, "Precomputed atmospheric scattering", in the formulation that Bruneton published
in 2017. Positions are relative to the centre of the planet [m]; `precompute/atmosphere_tables.py` fills the tables.
"""
