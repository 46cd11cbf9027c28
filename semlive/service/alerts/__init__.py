"""Alerts to persons who are not at the instrument: by webhook, e-mail or messenger."""
