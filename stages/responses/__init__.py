"""Responses to a drive or load: attachments, targets, platforms."""
