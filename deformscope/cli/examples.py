"""The example at the end of each command's `--help`: lines that run as they are typed, in an empty folder."""

_DOUBLES = "deformscope rig new rig.toml --doubles\n"
_PLACED = _DOUBLES + "deformscope calibrate tip rig.toml\ndeformscope calibrate place rig.toml\n"
_SEEN = _PLACED + "deformscope calibrate camera rig.toml\ndeformscope calibrate force rig.toml\n"
_PAIR = "deformscope calibrate beta sample:pair --record pair.rrd\n"
_BENCH = "deformscope record lab:bench --seconds 2 --record bench.rrd\n"
_TRIAL = "deformscope squeeze lab:containers --content rice --container box-01 --dataset squeezes\n"
_KUKA = "printf '[devices.arm]\\ndriver = \"kuka\"\\n' > kuka.toml\n"

EXAMPLES: dict[str, str] = {
    "demo": "deformscope demo --images",
    "explore": "deformscope explore lab:two-60-150 --seed 3 --touches 3 --picture map.png",
    "calibrate beta": "deformscope calibrate beta sample:pair --picture beta.png",
    "calibrate theta": "deformscope calibrate theta sample:cube --picture theta.png",
    "calibrate axes": "deformscope calibrate axes sample:pair --picture axes.png",
    "calibrate field": "deformscope calibrate field sample:pair --picture field.png",
    "calibrate yield": "deformscope calibrate yield sample:press --picture yield.png",
    "calibrate viscous": "deformscope calibrate viscous sample:press --picture viscous.png",
    "predict": "deformscope calibrate beta sample:poke --thickness-m 0.05 --save slab.npz\n"
    "deformscope predict slab.npz --poke 'at=0.28,0.2 tip=flat size=0.03x0.03 force=5' --picture dent.png",
    "simulate": "deformscope calibrate beta sample:poke --thickness-m 0.05 --save slab.npz\n"
    "deformscope simulate slab.npz --in mujoco --out slab --vertices 300 --poke 'at=0.28,0.2 depth=0.005'",
    "indent": "deformscope explore lab:homogeneous-60 --touches 1 --pace quick --beta-model none --record foam.rrd\n"
    "deformscope indent foam.rrd --tip sphere:0.02 --thickness-m 0.05 --bonded --poisson 0.3 --picture curves.png",
    "squeeze": "deformscope squeeze lab:containers --content rice --container box-01",
    "classify": "deformscope classify sample:table --quick --report classified.html",
    "flow": "deformscope flow sample:tension/frame_152.png sample:tension/frame_160.png --out flow.npz",
    "rig new": "deformscope rig new rig.toml --device arm=kuka --device tip=optoforce:/dev/ttyACM0",
    "doctor": "deformscope doctor sample:rig",
    "devices": "deformscope devices",
    "calibrate tip": _DOUBLES + "deformscope calibrate tip rig.toml",
    "calibrate place": _PLACED.strip(),
    "calibrate camera": _DOUBLES + "deformscope calibrate camera rig.toml --picture views.png",
    "calibrate force": _PLACED + "deformscope calibrate force rig.toml",
    "calibrate tool": _PLACED + "deformscope calibrate force rig.toml\ndeformscope calibrate tool rig.toml",
    "calibrate time": _DOUBLES + "deformscope calibrate time rig.toml",
    "calibrate arm": "deformscope calibrate arm lab:homogeneous-rigid",
    "calibrate wrench": "deformscope calibrate wrench lab:homogeneous-60 --places 6",
    "certify": "deformscope certify lab:block-162 --sample lab-block --touches 1",
    "arm where": "deformscope arm where sample:rig",
    "arm files": _KUKA + "deformscope arm files kuka.toml --out controller",
    "arm home": "deformscope arm home sample:rig --yes",
    "arm go": _SEEN + "deformscope arm go rig.toml --above 0.30,0.20",
    "arm jog": _SEEN + "deformscope arm jog rig.toml",
    "record": _BENCH.strip(),
    "live": "deformscope live lab:bench --seconds 3 --stage tactile --viewer page",
    "new-device": "deformscope new-device mysensor --kind force",
    "double": "deformscope double optoforce --seconds 3",
    "replay": _PAIR + "deformscope replay pair.rrd",
    "verify": _PAIR + "deformscope verify pair.rrd --stages",
    "report": _PAIR + "deformscope report pair.rrd --out pair.html",
    "catalog": _PAIR + "deformscope catalog .",
    "catalog compare": _PAIR
    + "deformscope calibrate beta sample:pair --method gradient --record gradient.rrd\n"
    + "deformscope catalog compare pair.rrd gradient.rrd",
    "sweep": _PAIR + "deformscope sweep . --vary cluster-size=3,4 --out fits -- calibrate beta",
    "export": _BENCH + "deformscope export bench.rrd --to csv --out tables",
    "import": _BENCH
    + "deformscope export bench.rrd --to csv --out tables\n"
    + "deformscope import --inspect tables > map.toml\n"
    + "deformscope import tables --map map.toml --record again.rrd",
    "recover": _BENCH + "head -c -100000 bench.rrd > cut.rrd\ndeformscope recover cut.rrd",
    "discard": _PAIR + "deformscope discard pair.rrd --reason 'the tip slipped'",
    "dataset list": _TRIAL + "deformscope dataset list squeezes",
    "dataset relabel": _TRIAL + "deformscope dataset relabel squeezes lab-0-box-01-00000 --content flour",
    "dataset discard": _TRIAL + "deformscope dataset discard squeezes lab-0-box-01-00000 --reason 'it leaked'",
    "dataset merge": _TRIAL + "deformscope dataset merge all squeezes",
    "dataset repair": _TRIAL + "deformscope dataset repair squeezes",
    "bench": "deformscope bench --quick --only step,relax",
}
"""By command."""
