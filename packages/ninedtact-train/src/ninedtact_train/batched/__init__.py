"""Many simulated sensors at once on one device: requests of sessions go in, solved contacts and rendered brightness come out.

A session yields requests (`session_requests.py`): a contact step, or a rendered image. `run_session_on_cpu` computes the requests
of one session one by one. `executor.py` collects those of many sessions in batches and computes each batch at once, on a GPU or
with torch on the processor; `contact_batch.py` solves and validates one batch of contact steps with the solver of
`ninedtact.mechanics`.
"""
