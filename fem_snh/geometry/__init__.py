"""Shapes, motions and trees of rigid parts, in numpy: signed distances, poses, surfaces."""
