"""Section of photographs: network, residuals, cameras, rejected rays."""
