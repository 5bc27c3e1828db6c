//! A GPU that answers queries: which of wgpu's there is, one in software (Debian: mesa-vulkan-drivers) among them.

use gdibl_runtime::gpu::GpuBuffers;
use gdibl_shader_tests::WORKGROUP;
use wgpu::util::DeviceExt;

/// Where light is asked for: relative to the volume's min, metres.
#[derive(Clone, Copy, Debug)]
pub struct Query {
    pub position: [f32; 3],
    pub normal: [f32; 3],
    /// Not chosen to lie where light may jump.
    pub anywhere: bool,
}

pub struct Gpu {
    pub name: String,
    device: wgpu::Device,
    queue: wgpu::Queue,
}

impl Gpu {
    /// None where there is none.
    pub fn open() -> Option<Gpu> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default())).ok()?;
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor::default()))
            .expect("a device with WebGPU's least limits");
        Some(Gpu { name: adapter.get_info().name, device, queue })
    }

    pub fn pipeline(&self, source: wgpu::ShaderSource<'_>, entry: &str) -> wgpu::ComputePipeline {
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source });
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: None,
            module: &module,
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        })
    }

    /// Irradiance for every query.
    pub fn irradiance(
        &self,
        pipeline: &wgpu::ComputePipeline,
        volume: &GpuBuffers,
        queries: &[Query],
    ) -> Vec<[f32; 3]> {
        assert_eq!(queries.len() % WORKGROUP, 0);
        let words = |words: &[u32]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
        let rows = queries.iter().flat_map(|query| [query.position, query.normal]);
        let queries_bytes = rows.flat_map(|[x, y, z]| [x, y, z, 0.0]).flat_map(f32::to_le_bytes).collect();
        let storage = wgpu::BufferUsages::STORAGE;
        let buffers = [
            (volume.header.to_vec(), wgpu::BufferUsages::UNIFORM),
            (words(&volume.coefficients), storage),
            (words(&volume.marks), storage),
            (words(volume.walls.as_flattened()), storage),
            (queries_bytes, storage),
            (vec![0xff; 16 * queries.len()], storage | wgpu::BufferUsages::COPY_SRC),
        ]
        .map(|(contents, usage)| {
            let descriptor = wgpu::util::BufferInitDescriptor { label: None, contents: &contents, usage };
            self.device.create_buffer_init(&descriptor)
        });
        let entries: Vec<_> = (0..)
            .zip(&buffers)
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let bind_group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        let read_back = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: 16 * queries.len() as u64,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });

        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &bind_group, &[]);
        pass.dispatch_workgroups((queries.len() / WORKGROUP) as u32, 1, 1);
        drop(pass);
        encoder.copy_buffer_to_buffer(&buffers[5], 0, &read_back, 0, read_back.size());
        self.queue.submit([encoder.finish()]);
        read_back.map_async(wgpu::MapMode::Read, .., |result| result.expect("results can be read"));
        self.device.poll(wgpu::PollType::wait_indefinitely()).expect("the device finishes");

        let bytes = read_back.get_mapped_range(..).expect("it is mapped");
        let floats = bytes.as_chunks::<4>().0.iter().map(|&word| f32::from_le_bytes(word)).collect::<Vec<f32>>();
        floats.as_chunks::<4>().0.iter().map(|&[r, g, b, _]| [r, g, b]).collect()
    }
}
