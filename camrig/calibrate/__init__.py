"""Calibration from many pictures at once. Pure: arrays in, arrays out; no files, no cameras."""
