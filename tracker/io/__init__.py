"""Readers and writers of files, one module per format; nothing here estimates anything.

Import the module that you need: ``tracker.io.detections``, ``tracker.io.arrays``.
"""
