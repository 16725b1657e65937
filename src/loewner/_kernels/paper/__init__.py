"""The paper's four detectors."""
