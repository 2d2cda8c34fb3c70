"""The result of `ninedtact calibrate` as JSON and as text: the certificate with its checks."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder


def calibration_json_dict(sensor: "SensorFolder") -> dict[str, object]:
    """Return the certificate and its checks for scripts."""
    import msgspec

    from ninedtact.calibration.certificate.checks import compute_certificate_checks, overall_check_level

    certificate = sensor.record.certificate
    assert certificate is not None
    return {
        "sensor": str(sensor.path),
        "id": sensor.id,
        "result": overall_check_level(certificate),
        "board": None,
        "ball": None,
        "warnings": [],
        **msgspec.to_builtins(certificate),
        "checks": [asdict(check) for check in compute_certificate_checks(certificate)],
    }


def format_calibration(sensor: "SensorFolder") -> Iterator[str]:
    """Yield the certificate in a few lines."""
    from ninedtact.calibration.certificate.checks import certificate_headline, compute_certificate_checks

    certificate = sensor.record.certificate
    assert certificate is not None
    yield f"sensor {sensor.id} calibrated: {sensor.path}   (± is one standard deviation)"
    if (board := certificate.board) is not None:
        yield (
            f"  board  {board.pins_found} of {board.pins_expected} pins, leave-one-out error {board.leave_one_out_rms_mm:.3f} mm "
            f"(the paper's method: {board.published_method_rms_mm:.3f} mm)"
        )
        yield f"  scale  {board.mm_per_px:.5f} ± {board.mm_per_px_std:.5f} mm per pixel"
    else:
        yield f"  scale  {sensor.record.grid.mm_per_px:.5f} mm per pixel, with the imported rectification"
    if (ball := certificate.ball) is not None:
        yield (
            f"  ball   radius {ball.ball_radius_mm:g} mm, pressed {ball.max_indentation_mm:.2f} mm deep, reconstructed to "
            f"{ball.reconstruction_mae_mm:.3f} mm, noise {ball.noise_mm:.4f} mm, method {ball.method}"
        )
    yield from (f"  warning: {warning}" for warning in certificate.warnings)
    yield f"  {certificate_headline(certificate)}"
    yield from (
        f"  {check.level}: {check.text}" for check in compute_certificate_checks(certificate) if check.level != "pass"
    )
    yield f"  open {sensor.path / 'certificate.html'} in a browser"
