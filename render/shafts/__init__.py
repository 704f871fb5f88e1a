"""Shafts of light and shadows in air and fog: scenes of meshes, sun and lamps, and several ways to march through them."""
