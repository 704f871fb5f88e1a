"""Physics vocabulary and forward images: volumes, cameras, phase functions, ray marching, the reference path tracer."""
