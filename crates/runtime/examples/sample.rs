//! Prints the irradiance that falls on a surface: `sample FILE.gdibl x y z nx ny nz`; without numbers, one query a line
//! from standard input.

use gdibl_runtime::Volume;
use std::error::Error;
use std::io::BufRead;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: sample FILE.gdibl [x y z nx ny nz]")?;
    let volume = Volume::parse(&std::fs::read(path)?)?;
    let numbers: Vec<String> = arguments.collect();
    if !numbers.is_empty() {
        return print_irradiance(&volume, &numbers.join(","));
    }
    for line in std::io::stdin().lock().lines() {
        print_irradiance(&volume, &line?)?;
    }
    Ok(())
}

fn print_irradiance(volume: &Volume, query: &str) -> Result<(), Box<dyn Error>> {
    let numbers: Vec<f64> = query.split(',').map(|number| number.trim().parse()).collect::<Result<_, _>>()?;
    let [x, y, z, nx, ny, nz] = numbers[..] else {
        return Err("expected six numbers: position x y z, unit normal x y z".into());
    };
    let normal = [nx, ny, nz].map(|value| value as f32);
    let sample = volume.sample_f64([x, y, z], normal);
    if !sample.inside {
        eprintln!("outside the volume: this is its nearest place");
    }
    // A surface reflects albedo / pi of this.
    let [r, g, b] = sample.sh.convolve().evaluate(normal);
    println!("{r:.9e},{g:.9e},{b:.9e}");
    Ok(())
}
