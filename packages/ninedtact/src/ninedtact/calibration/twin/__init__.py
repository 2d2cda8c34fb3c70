"""The digital twin of a sensor, from its own calibration images. In: one ball press or two (and the image of the pressed board).
Out: `TwinFit`, the presses, the gel and the light that explain the whole images, with uncertainties
(`ball_press_fit.fit_twin_to_ball_press`), and the simulated sensor (`sensor_twin.assemble_twin`). What the fits predict is in
`ninedtact.simulation.calibration_press_models`. No rule about where the ball's disc ends is needed.
"""
