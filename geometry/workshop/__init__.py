"""What a workshop gets beside the solids: drawings as DXF and PDF, film patterns, moulds, lists and the order of assembly."""
