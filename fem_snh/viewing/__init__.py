"""Plots, pictures, pages and exports, made from the files of a run."""
