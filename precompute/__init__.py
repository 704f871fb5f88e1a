"""Everything that fills tables: path-traced scattering stacks and the store that keeps them on disk."""
