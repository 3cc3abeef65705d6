"""What follows a drive: attachments, targets, loads."""
