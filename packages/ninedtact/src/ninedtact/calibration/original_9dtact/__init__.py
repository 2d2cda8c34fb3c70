"""Calibration folders of the original 9DTact project. In and out: its `sensor_N` folder and a sensor folder
(`import_export.import_original_calibration`, `import_export.export_original_calibration`); `folder_format` reads and checks
its files.
"""
