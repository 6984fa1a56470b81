"""Write a workshop's files besides the solids: drawings as DXF and PDF, film patterns, moulds, lists and assembly order."""
