import time, sys
import numpy as np, warp as wp
wp.config.quiet=True
from deformscope.stages.msm.clusters import lattice
from deformscope.stages.msm.solver import Msm
def cube(n,s=3,precision="float32"):
    r=np.stack(np.meshgrid(*[np.arange(n)]*3,indexing="ij"),-1).reshape(-1,3)*0.01
    held=np.r_[np.arange(n*n),np.arange(n**3-n*n,n**3)]; t=r[held].copy(); t[n*n:,0]-=.1*n*.01
    t0=time.time(); b=Msm(r,lattice(r,(n,n,n),np.arange(n**3),s),held,precision=precision,device="cuda:0")
    return b,t
def step(n,B,s=3,steps=200):
    t0=time.time(); b,t=cube(n,s); 
    betas=np.linspace(0,.9,B) if B>1 else .7
    m=b.start(B); b.step(m,t,betas,steps=3); wp.synchronize(); setup=time.time()-t0
    best=[]
    from deformscope.stages.msm.solver import _Stepping
    hu,bb,tt=b._candidates(t,betas,0.0)
    st=_Stepping(b,m,hu,bb,tt,0,1.0,2e-3,None)
    st.run(10); wp.synchronize()
    for _ in range(5):
        t0=time.perf_counter(); st.run(steps); wp.synchronize(); best.append((time.perf_counter()-t0)/steps)
    x=np.median(best)
    print(f"n={n} B={B} s={s} threads={m.operator.threads}: {x*1e6:.2f} us/step, {B/x/1e6:.3f} M sim-steps/s, setup {setup:.1f}s ran_away={m.diverged.any()}",flush=True)
for a in (sys.argv[1:] if __name__=="__main__" else []):
    step(*[int(v) for v in a.split(",")])
