"""Sources of user modules and classes that fail when they are imported or inspected."""

MODULES = {  # source, line of the cause, part of the error
    "raises": ("import json\n\njson.loads('x')\n", 3, "JSONDecodeError"),
    "raises a text of many lines": ("raise ValueError('a\\nb' * 500)\n", 1, "ValueError"),
    "exits": ("import sys\n\nsys.exit(3)\n", 3, "it exits: 3"),
    "is no Python": ("x = 1\ndef f(:\n", 2, "SyntaxError"),
    "recurses": ("def f():\n    f()\nf()\n", 2, "RecursionError"),
    "raises an interrupt": ("x = 1\nraise KeyboardInterrupt\n", 2, "KeyboardInterrupt"),
    "lacks a module": ("import no_such_module_at_all\n", 1, "ModuleNotFoundError"),
    "prints and raises": ("print('noise')\nraise OSError(5, 'x')\n", 2, "OSError"),
    "has an error without a text": (
        "class E(Exception):\n    def __str__(self): raise ValueError\nraise E\n", 3, "E",
    ),
}  # fmt: skip
ENDING = {  # likewise; these end the process that imports them, or prevent its report
    "ends the process": ("import os\n\nos._exit(0)\n", 3, "it exits: os._exit(0)"),
    "closes the stream": ("import sys\nsys.stderr.close()\n1 / 0\n", 3, "ZeroDivisionError"),
    "closes the file": ("import os\nos.close(2)\n1 / 0\n", 3, "ZeroDivisionError"),
    "has no streams": ("import sys\nsys.stderr = None\n1 / 0\n", 3, "ZeroDivisionError"),
}
HEAD = """\
from dataclasses import dataclass
from pipeline import Frame, Input, Operator, Output

@dataclass(frozen=True, kw_only=True)
class Settings:
    x: int = 1

"""
HANDLER = "class Part(Operator[Settings, Frame]):\n    frame = Input(Frame)\n    {}\n"
METHODS = {  # source of a method, and its error
    "a handler of two": (
        "def on_frame(self, frame, other): pass",
        "on_frame: expected the arguments frame, got frame, other",
    ),
    "a handler of another name": (
        "def on_frame(self, picture): pass",
        "on_frame: expected the arguments frame, got picture",
    ),
    "a handler of none": (
        "def on_frame(self): pass",
        "on_frame: expected the arguments frame, got none",
    ),
    "a handler by position": (
        "def on_frame(self, frame, /): pass",
        "on_frame: expected the arguments frame, got frame",
    ),
    "no argument for settings": (
        "def __init__(self): pass",
        "__init__: expected the arguments settings, got none",
    ),
    "an asynchronous handler": (
        "async def on_frame(self, frame): pass",
        "on_frame: expected def, got async def",
    ),
    "an asynchronous opening": (
        "async def open(self): pass",
        "open: expected def, got async def",
    ),
}
CLASSES = {
    "live is no tuple": "class Part(Operator[Settings, None]):\n    live = 5\n",
    "live is a text": "class Part(Operator[Settings, None]):\n    live = 'x'\n",
    "live names nothing": "class Part(Operator[Settings, None]):\n    live = ('y',)\n",
    "commands are none": "class Part(Operator[Settings, None]):\n    commands = None\n",
    "a command has no method": "class Part(Operator[Settings, None]):\n    commands = ('go',)\n",
    "a command has no types": (
        "class Part(Operator[Settings, None]):\n    commands = ('go',)\n"
        "    def do_go(self, x): pass\n"
    ),
    "a command's types do not resolve": (
        "class Part(Operator[Settings, None]):\n    commands = ('go',)\n"
        "    def do_go(self, x: 'Nowhere'): pass\n"
    ),
    "an input of no message": "class Part(Operator[Settings, None]):\n    frame = Input(5)\n",
    "an input of a text": "class Part(Operator[Settings, None]):\n    frame = Input('Frame')\n",
    "an input kept oddly": (
        "class Part(Operator[Settings, None]):\n    frame = Input(Frame, keep='some')\n"
    ),
    "an input too deep": (
        "class Part(Operator[Settings, None]):\n    frame = Input(Frame, depth=10**9)\n"
    ),
    "an input with a name that is none": (
        "class Part(Operator[Settings, None]):\n    pass\nsetattr(Part, '../x', Input(Frame))\n"
    ),
    "an output with a name that is none": (
        "class Part(Operator[Settings, None]):\n    pass\nsetattr(Part, 'a/b', Output(Frame))\n"
    ),
    "an output of no message": "class Part(Operator[Settings, None]):\n    out = Output(int)\n",
    "no settings": "class Part(Operator):\n    pass\n",
    **{what: HANDLER.format(method) for what, (method, _said) in METHODS.items()},
    "settings that are no dataclass": "class Part(Operator[int, None]):\n    pass\n",
    "settings whose types do not resolve": (
        "@dataclass\nclass S:\n    x: 'Nowhere' = 1\nclass Part(Operator[S, None]):\n    pass\n"
    ),
    "settings that break over themselves": (
        "@dataclass\nclass S:\n    x: int = 1\n    def __post_init__(self): 1 / 0\n"
        "class Part(Operator[S, None]):\n    pass\n"
    ),
}
