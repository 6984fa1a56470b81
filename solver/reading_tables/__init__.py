"""Tables of low rank from which readings over many candidate tumours are predicted, for inference from scans."""
