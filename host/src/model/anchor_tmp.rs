#[cfg(test)]
mod t {
    use crate::model::{averaged::*, carrier::*, parameters::*, plant::*, modulation::*};
    pub fn thesis() -> Parameters {
        Parameters::from_array([45000.0,105.0,0.624,5469.328,4.798e10,0.5439,0.7,0.013675,1e-3,6.0,0.00025,6.09e-3,765.58e-9,35.0,2e-7,0.1057,1.0,0.0,20761245675.0/3.33,0.1057])
    }
    pub fn phys() -> Parameters {
        let mut p = thesis();
        p.modal_mass_kg *= 2e-3; p.modal_damping_ns_m *= 2e-3; p.modal_stiffness_n_m *= 2e-3; p.frequency_hz = 45600.0; p.preload_n=10.38; p.force_factor_n_v = 0.0725;
        p
    }
    #[test]
    fn transient() {
        for (p, fl) in [(thesis(), Flavour::Thesis), (phys(), Flavour::Physical)] {
            let mut c = Carrier::new(p, fl);
            let mut a = Averaged::new(p, fl);
            let mut t = 0.0;
            for i in 0..60 {
                let d = if i%30 < 15 { Drive::ON } else { Drive::OFF };
                t += 1e-4;
                c.run(1e-4, d, &Modulation::NONE);
                a.advance(t, d, &mut |_| ());
                println!("{i} W {:.4e} {:.4e}  z {:.3e} {:.3e} v {:.5} {:.5} th {:.6} {:.6} st {}", c.amplitude_m(), a.amplitude_m(), c.state()[4], a.height_m(), c.state()[7], a.speed_rad_s(), c.state()[6], a.position_rad(), a.steps());
            }
        }
    }
    #[test]
    fn grid() {
        for (p, fl) in [(thesis(), Flavour::Thesis), (phys(), Flavour::Physical)] {
            for k in [1,2,3,4,6,8,12,16,20,24,28,30,31,32] {
                let duty = k as f64/32.0;
                let mut c = Carrier::new(p, fl);
                let mut a = Averaged::new(p, fl);
                let n = 40; let mut c0=0.0; let mut a0=0.0; let mut s=0; let t0=std::time::Instant::now(); let mut ta=0.0;
                for i in 0..n {
                    if i == n-15 { c0=c.state()[6]; a0=a.position_rad(); s=a.steps(); }
                    let off=(1.0-duty)*0.02;
                    c.run(off, Drive::OFF, &Modulation::NONE);
                    c.run(0.02-off, Drive::ON, &Modulation::NONE);
                    let t=std::time::Instant::now();
                    a.advance(i as f64*0.02+off, Drive::OFF, &mut |_| ());
                    a.advance((i+1) as f64*0.02, Drive::ON, &mut |_| ());
                    ta+=t.elapsed().as_secs_f64();
                }
                let r = 30.0/std::f64::consts::PI/0.3;
                let (vc,va)=((c.state()[6]-c0)*r,(a.position_rad()-a0)*r);
                println!("{fl} {duty:.3} carrier {:.4} avg {:.4} diff {:.4} rel {:.3} %  steps/period {} xRT {:.0} carrier Msteps/s {:.2}", vc, va, va-vc, (va/vc-1.0)*100.0, (a.steps()-s)/15, 1.0/ta, 10.0/t0.elapsed().as_secs_f64());
            }
        }
    }
}
