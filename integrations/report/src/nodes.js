// Nodes as spheres that show their light: those near the camera each with its own, the others as points.
import { BufferAttribute, BufferGeometry, DataTexture, FloatType, GLSL3, IcosahedronGeometry, InstancedBufferAttribute, InstancedBufferGeometry, Mesh, Points, RGBAFormat, ShaderMaterial } from 'three';
import { mergeVertices } from 'three/addons/utils/BufferGeometryUtils.js';
import { DISPLAY } from './surfaces.js';

const MOST_SPHERES = 2000;
const MOST_POINTS = 100_000;

const SPHERES = `
uniform sampler2D lights;
in vec4 centre;
in float figure;
out vec3 light;
out float value;
void main() {
	light = texelFetch( lights, ivec2( gl_VertexID, gl_InstanceID ), 0 ).rgb;
	value = figure;
	gl_Position = projectionMatrix * modelViewMatrix * vec4( centre.xyz + centre.w * position, 1.0 );
}`;

const POINTS = `
uniform float size;
in vec3 colour;
in float figure;
out vec3 light;
out float value;
void main() {
	light = colour;
	value = figure;
	gl_Position = projectionMatrix * modelViewMatrix * vec4( position, 1.0 );
	gl_PointSize = clamp( size / gl_Position.w, 1.5, 12.0 );
}`;

const FRAGMENT = `${ DISPLAY }
in vec3 light;
in float value;
out vec4 shown;
void main() {
	shown = vec4( mode == FIGURE ? heatOf( value ) : display( max( light, 0.0 ) / 3.14159265358979 ), 1.0 );
}`;

const material = ( vertexShader, uniforms ) => new ShaderMaterial( { glslVersion: GLSL3, vertexShader, fragmentShader: FRAGMENT, uniforms } );

export class Nodes {

	/** `opened`: what the worker told of a volume. */
	constructor( worker, opened, radius, uniforms ) {

		Object.assign( this, { worker, opened, radius } );
		const sphere = mergeVertices( new IcosahedronGeometry( 1, 2 ).deleteAttribute( 'uv' ).deleteAttribute( 'normal' ) );
		this.directions = new Float32Array( sphere.getAttribute( 'position' ).array );
		this.sphere = sphere;
		this.uniforms = { ...uniforms, lights: { value: null } };
		this.spheres = new Mesh( this.geometry( 0 ), material( SPHERES, this.uniforms ) );
		this.points = new Points( new BufferGeometry(), material( POINTS, { ...uniforms, size: { value: 1 } } ) );
		this.spheres.frustumCulled = this.points.frustumCulled = false;
		this.ready = this.fillPoints();

	}

	async fillPoints() {

		const { worker, opened, points } = this;
		this.some = await worker( 'some', { index: opened.index, step: Math.ceil( opened.count / MOST_POINTS ) } );
		points.geometry.setAttribute( 'position', new BufferAttribute( this.some.places, 3 ) );
		points.geometry.setAttribute( 'colour', new BufferAttribute( this.some.light, 3 ) );
		points.geometry.setAttribute( 'figure', new BufferAttribute( new Float32Array( this.some.count ), 1 ) );
		this.showFigure( this.key );

	}

	geometry( count ) {

		const made = new InstancedBufferGeometry();
		made.setAttribute( 'position', this.sphere.getAttribute( 'position' ) );
		made.setIndex( this.sphere.getIndex() );
		made.setAttribute( 'centre', new InstancedBufferAttribute( new Float32Array( 4 * count ), 4 ) );
		made.setAttribute( 'figure', new InstancedBufferAttribute( new Float32Array( count ), 1 ) );
		made.instanceCount = count;
		return made;

	}

	set visible( is ) {

		this.spheres.visible = this.points.visible = is;

	}

	/** Pixels that a sphere a metre away is wide. */
	set pixels( size ) {

		this.points.material.uniforms.size.value = size * this.radius;

	}

	/** Which figure all of them show. */
	showFigure( key ) {

		this.key = key;
		for ( const [ { geometry }, nodes ] of [ [ this.points, this.some ], [ this.spheres, this.around ] ] ) {

			if ( ! nodes ) continue;
			const attribute = geometry.getAttribute( 'figure' );
			attribute.array.set( nodes.figures[ key ] ?? new Float32Array( nodes.count ) );
			attribute.needsUpdate = true;

		}

	}

	/** Gives the nodes around a place their own spheres. */
	async chooseAround( place ) {

		await this.ready;
		const { worker, opened, directions } = this;
		const around = await worker( 'around', { index: opened.index, place, count: MOST_SPHERES, normals: directions } );
		const width = directions.length / 3;
		const texels = new Float32Array( 4 * width * Math.max( 1, around.count ) );
		for ( let k = 0; k < width * around.count; k ++ ) for ( let c = 0; c < 3; c ++ ) texels[ 4 * k + c ] = around.irradiance[ 3 * k + c ];
		this.uniforms.lights.value?.dispose();
		this.uniforms.lights.value = new DataTexture( texels, width, Math.max( 1, around.count ), RGBAFormat, FloatType );
		this.uniforms.lights.value.needsUpdate = true;
		this.spheres.geometry.dispose();
		this.spheres.geometry = this.geometry( around.count );
		const centres = this.spheres.geometry.getAttribute( 'centre' ).array;
		for ( let k = 0; k < around.count; k ++ ) centres.set( [ ...around.places.subarray( 3 * k, 3 * k + 3 ), this.radius * ( around.figures.cell_size?.[ k ] ?? 1 ) ], 4 * k );
		this.around = around;
		this.showFigure( this.key );

	}

}
