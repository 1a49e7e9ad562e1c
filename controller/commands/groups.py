"""Groups of commands in `hyperbit --help`, with an example of each; the same as in controller/commands/README.md."""

GROUPS = {
    "Use an arm": {
        "send": "hyperbit send planar16 --to 0.4,2.9",
        "watch": "hyperbit watch planar16",
        "cancel": "hyperbit cancel planar16",
        "stop": "hyperbit stop planar16",
        "halt": "hyperbit halt --local",
        "reset": "hyperbit reset planar16",
        "jog": "hyperbit jog planar16 5.left=extended",
        "degrade": "hyperbit degrade planar16 5.left=contracted",
        "lock": "hyperbit lock planar16 5.left=contracted 7.right=free",
        "obstacles": "hyperbit obstacles planar16 --none",
        "panel": "hyperbit panel",
        "record": "hyperbit record planar16",
        "replay": "hyperbit replay --goals recording.mcap",
    },
    "Operate the daemon": {
        "run": "hyperbit run my-arm.yaml",
        "execute": "hyperbit execute my-arm.yaml",
        "simulate": "hyperbit simulate my-arm.yaml --board fixed-mapping",
        "demo": "hyperbit demo --animation demo.gif",
        "wear": "hyperbit wear my-arm.yaml",
    },
    "Configure arm and boards": {
        "check": "hyperbit check my-arm.yaml --bus",
        "probe": "hyperbit probe can0 --json",
        "node-id": "hyperbit node-id can0 5",
        "board": "hyperbit board my-arm.yaml can0/5 errors",
        "exercise": "hyperbit exercise planar16",
        "calibrate": "hyperbit calibrate my-arm.yaml samples.csv --out better.yaml",
    },
    "Study arms": {
        "plan": "hyperbit plan deploy/planar16.yaml --goal 0.55,2.9,0.3",
        "fk": "hyperbit fk deploy/planar16.yaml 4646676700771206",
        "map": "hyperbit map deploy/planar16.yaml",
        "workspace": "hyperbit workspace deploy/planar16.yaml --at 0.55,2.9",
        "figure5": "hyperbit figure5",
        "bench": "hyperbit bench --set lattice",
    },
}
EXAMPLES = {name: example for examples in GROUPS.values() for name, example in examples.items()}
