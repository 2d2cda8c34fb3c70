"""The certificate of a calibration. In: a `Calibration`. Out: the checks with their limits (`checks.compute_certificate_checks`)
and one HTML page with plots and tables (`html_page.render_certificate_html`).
"""
