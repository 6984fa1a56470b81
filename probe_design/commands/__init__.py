"""The commands: each is one frozen request, from which its options, its Python keywords, their checks and help follow.

Modules of requests are imported when their command is used, and import what computes and draws inside functions: ``--help`` of
all commands needs click alone, that of one command also the models of scenes.
"""
