"""The probe's protocol: frames, requests, and what decodes them."""
