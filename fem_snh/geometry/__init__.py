"""Shapes, motions and skeletons, in numpy alone: signed distances, poses, surfaces."""
