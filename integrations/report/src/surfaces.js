// The level's surfaces: a pass that tells where each pixel is, and one that shows its light.
import { BufferAttribute, BufferGeometry, DataTexture, DoubleSide, FloatType, FrontSide, GLSL3, Mesh, NearestFilter, RGBAFormat, ShaderMaterial, WebGLRenderTarget } from 'three';
import { heatTable } from './scales.js';

const VERTEX = `
in vec3 albedo, emission;
in vec4 light;
out vec3 place, facing, colour, glow;
out vec4 atCorners;
void main() {
	place = position;
	facing = normal;
	colour = albedo;
	glow = emission;
	atCorners = light;
	gl_Position = projectionMatrix * modelViewMatrix * vec4( position, 1.0 );
}`;

// Toward the camera, as the triangle is seen; between corners where the level is smooth.
const NORMAL = `
in vec3 place, facing;
vec3 seenNormal() {
	vec3 flatNormal = normalize( cross( dFdx( place ), dFdy( place ) ) );
	if ( dot( flatNormal, cameraPosition - place ) < 0.0 ) flatNormal = - flatNormal;
	vec3 n = normalize( facing );
	if ( dot( n, flatNormal ) < 0.0 ) n = - n;
	return n == n ? n : flatNormal;
}`;

const PLACES = `${ NORMAL }
layout( location = 0 ) out vec4 whereIt;
layout( location = 1 ) out vec4 facesTo;
void main() {
	whereIt = vec4( place, 1.0 );
	facesTo = vec4( seenNormal(), 1.0 );
}`;

/** Display of light and figures, shared by surfaces and nodes. */
export const DISPLAY = `
uniform int mode;
uniform float gain;
uniform vec2 scale;
uniform sampler2D heat;
const int LIT = 0, WHITE = 1, FIGURE = 2;
vec3 display( vec3 radiance ) {
	vec3 v = clamp( radiance * gain, 0.0, 1.0 );
	return mix( 12.92 * v, 1.055 * pow( v, vec3( 1.0 / 2.4 ) ) - 0.055, step( 0.0031308, v ) );
}
vec3 heatOf( float figure ) {
	if ( figure < - 0.5 ) return vec3( 0.5 );
	float share = clamp( ( figure - scale.x ) / ( scale.y - scale.x ), 0.0, 1.0 );
	return texture( heat, vec2( ( share * 255.0 + 0.5 ) / 256.0, 0.5 ) ).rgb;
}`;

const SHOW = `${ NORMAL }${ DISPLAY }
in vec3 colour, glow;
in vec4 atCorners;
uniform sampler2D exact;
uniform bool isExact;
out vec4 shown;
const float PI = 3.14159265358979;
void main() {
	vec4 light = isExact ? texelFetch( exact, ivec2( gl_FragCoord.xy ), 0 ) : atCorners;
	vec3 e = max( light.rgb, 0.0 );
	if ( mode == LIT ) shown.rgb = display( glow + colour * e / PI );
	else if ( mode == WHITE ) shown.rgb = display( e / PI );
	else shown.rgb = heatOf( light.a ) * ( 0.75 + 0.25 * abs( dot( seenNormal(), normalize( cameraPosition - place ) ) ) );
	shown.a = 1.0;
}`;

/** Uniforms that say how numbers are shown. */
export function displayUniforms() {

	const heat = new DataTexture( heatTable(), 256, 1 );
	heat.needsUpdate = true;
	return { mode: { value: 0 }, gain: { value: 1 }, scale: { value: [ 0, 1 ] }, heat: { value: heat } };

}

export class Surfaces {

	constructor( mesh, uniforms ) {

		this.arrays = mesh;
		const geometry = new BufferGeometry();
		const corners = mesh.positions.length / 3;
		for ( const [ name, values, size ] of [ [ 'position', mesh.positions, 3 ], [ 'normal', mesh.normals, 3 ], [ 'albedo', mesh.albedo, 3 ], [ 'emission', mesh.emission, 3 ], [ 'light', new Float32Array( 4 * corners ), 4 ] ] ) geometry.setAttribute( name, new BufferAttribute( values, size ) );
		this.uniforms = { ...uniforms, exact: { value: null }, isExact: { value: false } };
		const material = ( fragmentShader, own ) => new ShaderMaterial( { glslVersion: GLSL3, vertexShader: VERTEX, fragmentShader, uniforms: own, side: FrontSide } );
		this.show = material( SHOW, this.uniforms );
		this.places = material( PLACES, {} );
		this.mesh = new Mesh( geometry, this.show );

	}

	/** Light at the corners: irradiance and a figure. */
	setLight( light ) {

		this.mesh.geometry.getAttribute( 'light' ).copyArray( light ).needsUpdate = true;

	}

	seeThroughBacks( does ) {

		for ( const material of [ this.show, this.places ] ) material.side = does ? FrontSide : DoubleSide;

	}

	/** Where each pixel of the picture is, and where it faces: of pixels that show the level, with their numbers. */
	async readPlaces( renderer, scene, camera, width, height ) {

		if ( ! this.target || this.target.width !== width || this.target.height !== height ) {

			this.target?.dispose();
			this.target = new WebGLRenderTarget( width, height, { count: 2, type: FloatType, minFilter: NearestFilter, magFilter: NearestFilter } );

		}

		const hidden = scene.children.filter( ( child ) => child !== this.mesh && child.visible );
		hidden.forEach( ( child ) => child.visible = false );
		this.mesh.material = this.places;
		renderer.setRenderTarget( this.target );
		renderer.setClearColor( 0, 0 );
		renderer.clear();
		renderer.render( scene, camera );
		renderer.setRenderTarget( null );
		this.mesh.material = this.show;
		hidden.forEach( ( child ) => child.visible = true );
		const [ all, facing ] = [ new Float32Array( 4 * width * height ), new Float32Array( 4 * width * height ) ];
		await renderer.readRenderTargetPixelsAsync( this.target, 0, 0, width, height, all, undefined, 0 );
		await renderer.readRenderTargetPixelsAsync( this.target, 0, 0, width, height, facing, undefined, 1 );
		let count = 0;
		for ( let k = 3; k < all.length; k += 4 ) count += all[ k ];
		const read = { width, height, all, facing, pixels: new Uint32Array( count ), positions: new Float32Array( 3 * count ), normals: new Float32Array( 3 * count ) };
		for ( let k = 0, n = 0; k < width * height; k ++ ) {

			if ( all[ 4 * k + 3 ] === 0 ) continue;
			read.pixels[ n ] = k;
			for ( let c = 0; c < 3; c ++ ) {

				read.positions[ 3 * n + c ] = all[ 4 * k + c ];
				read.normals[ 3 * n + c ] = facing[ 4 * k + c ];

			}

			n ++;

		}

		return read;

	}

	/** Light of every pixel that was read. */
	setExact( read, light ) {

		const texels = new Float32Array( 4 * read.width * read.height );
		read.pixels.forEach( ( pixel, k ) => {

			for ( let c = 0; c < 4; c ++ ) texels[ 4 * pixel + c ] = light[ 4 * k + c ];

		} );
		this.uniforms.exact.value?.dispose();
		const texture = new DataTexture( texels, read.width, read.height, RGBAFormat, FloatType );
		texture.needsUpdate = true;
		this.uniforms.exact.value = texture;
		this.uniforms.isExact.value = true;

	}

	forgetExact() {

		this.uniforms.isExact.value = false;

	}

}
