import time, sys
import numpy as np, warp as wp
wp.config.quiet=True
import gpu_check
from deformscope.stages.msm import solver
n=int(sys.argv[1]); B=int(sys.argv[2])
b,t=gpu_check.cube(n)
m=b.start(B); hu,bb,tt=b._candidates(t,.7 if B==1 else np.linspace(0,.9,B),0.0)
st=solver._Stepping(b,m,hu,bb,tt,0,1.0,2e-3,None)
op=m.operator; f=op.fields(st.parameters); kk=op.arrays.kernels; g=op.grid
def tm(name,fn):
    fn(); wp.synchronize()
    with wp.ScopedCapture(device="cuda:0") as c:
        for _ in range(10): fn()
    wp.capture_launch(c.graph); wp.synchronize(); t0=time.perf_counter(); wp.capture_launch(c.graph); wp.capture_launch(c.graph); wp.synchronize(); print(name,round((time.perf_counter()-t0)/20*1e6,2),"us",flush=True)
run=st.running; mo=st.motion
tm("fast",lambda: op._pass(kk.windows_fast,g.items_plane,[f,mo,run,m.u,m.before]))
tm("middle",lambda: op._pass(kk.windows_middle,g.items_windows,[f,run]))
tm("fit",lambda: op._fit(kk.fit_clusters,f,run,op.unkept()))
tm("slow",lambda: op._pass(kk.spread_slow,g.items_slow,[f,run]))
tm("mid2",lambda: op._pass(kk.spread_middle,g.items_spread,[f,run]))
tm("finish",lambda: op._pass(kk.finish,g.items_plane,[f,mo,run,m.u,m.before],[m.before,m.ran_away]))
